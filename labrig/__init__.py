"""Measure how light travels in scattering media.

Everything the command line does is one call of this module::

    plan = labrig.load_plan("configs/plans/six-shifts.yaml")
    with labrig.open_rig("configs/rigs/simulated.yaml", "configs/scenes/dilute-milk.yaml", plan) as rig:
        session = labrig.capture(plan, rig, "sessions")
    result = labrig.analyse(session)
    page = labrig.report(result)
"""
