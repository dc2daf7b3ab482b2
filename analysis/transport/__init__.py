"""How light spreads in the tank, bounce by bounce (Eqs. 1, 3, 4)."""
