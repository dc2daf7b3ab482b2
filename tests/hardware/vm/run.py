"""Boots a Debian kernel in qemu without KVM and runs the guest tests in it: ``make hardware-vm``.

Always by TCG: that /dev/kvm exists does not mean that a stock kernel boots under it.
"""

from __future__ import annotations

import gzip
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
PROGRAMS = (
    *(
        "qemu-system-x86_64",
        "busybox",
        "cpio",
        "apt-get",
        "dpkg-deb",
        "depmod",
        "modprobe",
        "udevadm",
    ),
)
PACKAGES = "qemu-system-x86 busybox-static cpio kmod udev v4l-utils usbutils"
EARLY_MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay")
LIMIT_S = 1500
APPEND = "console=ttyS0 quiet loglevel=4 panic=-1 tsc=unstable nokaslr mitigations=off"


def main() -> int:
    """Prepare what is missing, boot, return the tests' exit code."""
    missing = [program for program in PROGRAMS if shutil.which(program) is None]
    if missing:
        return _fail(f"{', '.join(missing)} not installed; run: sudo apt-get install {PACKAGES}")
    folder = Path(os.environ.get("LABRIG_VM_CACHE") or Path.home() / ".cache" / "labrig" / "vm")
    folder.mkdir(parents=True, exist_ok=True)
    kernel = prepare_kernel(folder)
    if kernel is None:
        return _fail(
            "no Debian kernel could be downloaded: apt-cache or apt-get download linux-image-amd64 "
            "failed, also after apt-get update. Is there a network, is this Debian on amd64?"
        )
    with tempfile.TemporaryDirectory(prefix="labrig-vm-") as scratch:
        initrd = make_initrd(kernel, Path(scratch))
        return boot(kernel, initrd, Path(scratch), sys.argv[1:])


def prepare_kernel(folder: Path) -> Path | None:
    """Return the folder of an unpacked kernel package, downloaded once; None if that failed."""
    unpacked = sorted(whole.parent for whole in folder.glob("*/whole"))
    if unpacked:
        return unpacked[-1]
    package = _download_kernel(folder)
    if package is None:  # lists of packages that are missing or old
        subprocess.run(["apt-get", "update", "-q"], check=False)
        package = _download_kernel(folder)
    if package is None:
        return None
    kernel = folder / package.name.split("_", maxsplit=1)[0]
    subprocess.run(["dpkg-deb", "-x", str(package), str(kernel)], check=True)
    package.unlink()
    subprocess.run(["depmod", "-b", str(kernel), _version(kernel)], check=True)
    (kernel / "whole").touch()
    return kernel


def _download_kernel(folder: Path) -> Path | None:
    """Return Debian's newest kernel package; None if apt does not know or get it."""
    command = ["apt-cache", "depends", "linux-image-amd64"]
    told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    names = [line.split()[-1] for line in told.splitlines() if "Depends:" in line]
    if not names:
        return None
    done = subprocess.run(["apt-get", "download", names[0]], cwd=folder, check=False)
    return next(folder.glob(f"{names[0]}_*.deb"), None) if done.returncode == 0 else None


def make_initrd(kernel: Path, scratch: Path) -> Path:
    """Return a ram disk with busybox and the modules that reach the host's root."""
    tree = scratch / "tree"
    for name in ("bin", "modules", "proc", "sys", "dev", "root"):
        (tree / name).mkdir(parents=True)
    shutil.copy(str(shutil.which("busybox")), tree / "bin" / "busybox")
    shutil.copy(HERE / "init.sh", tree / "init")
    (tree / "init").chmod(0o755)
    paths: list[str] = []
    for module in EARLY_MODULES:
        command = ["modprobe", "-d", str(kernel), "-S", _version(kernel), "-D", module]
        told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
        paths += [w for w in told.split() if w.endswith(".ko") and w not in paths]
    for n, path in enumerate(paths):
        shutil.copy(path, tree / "modules" / f"{n:02d}-{Path(path).name}")
    names = "\n".join(str(p.relative_to(tree)) for p in sorted(tree.rglob("*")))
    archive = subprocess.run(
        ["cpio", "-o", "-H", "newc", "--quiet"],
        cwd=tree,
        input=names.encode(),
        capture_output=True,
        check=True,
    )
    initrd = scratch / "initrd.gz"
    initrd.write_bytes(gzip.compress(archive.stdout, 1))
    return initrd


def boot(kernel: Path, initrd: Path, scratch: Path, arguments: list[str]) -> int:
    """Run the guest tests in a virtual machine whose root is this machine's; return their code."""
    shared = scratch / "out"
    shared.mkdir()
    # vivid first, while it is the one camera
    names = ("test_vivid.py", "test_uvc.py", "test_session.py", "test_usb_ports.py")
    behaviour = f"{ROOT}/tests/behaviour/test_every_camera.py --confcutdir={ROOT}/tests/behaviour"
    guest = " ".join(str(HERE / "guest" / name) for name in names)
    runs = [" ".join(arguments)] if arguments else [behaviour, f"{guest} --confcutdir={HERE}"]
    pytest = f"{sys.executable} -m pytest -q -p no:cacheprovider -o faulthandler_timeout=120"
    tests = "\n".join(f"{pytest} --durations=8 {run} || failed=$?" for run in runs)
    (shared / "command.sh").write_text(
        "export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8\n"
        f"export LABRIG_VM_KERNEL={kernel} PYTHONDONTWRITEBYTECODE=1\n"
        "/lib/systemd/systemd-udevd --daemon\n"
        f"cd {ROOT}\n"
        f"failed=0\n{tests}\nexit $failed\n"
    )
    nine = "security_model=none"
    command = [
        # with the newest processor and the usual buffer, importing labrig took 244 s and not 126
        *("qemu-system-x86_64", "-accel", "tcg,thread=multi,tb-size=512", "-cpu", "Nehalem"),
        *("-machine", "pc"),
        *("-m", "1024", "-smp", "2", "-nodefaults", "-no-user-config", "-display", "none"),
        *("-no-reboot", "-serial", "stdio", "-device", "virtio-rng-pci"),
        *("-kernel", str(next((kernel / "boot").glob("vmlinuz-*"))), "-initrd", str(initrd)),
        *("-append", APPEND),
        *("-fsdev", f"local,id=r,path=/,{nine},readonly=on,multidevs=remap"),
        *("-device", "virtio-9p-pci,fsdev=r,mount_tag=hostroot"),
        *("-fsdev", f"local,id=o,path={shared},{nine}"),
        *("-device", "virtio-9p-pci,fsdev=o,mount_tag=hostout"),
        *("-device", "qemu-xhci,id=xhci", "-chardev", "null,id=far"),
        *("-device", "usb-serial,bus=xhci.0,chardev=far,always-plugged=on,serial=LABRIG01"),
    ]
    try:
        subprocess.run(command, stdin=subprocess.DEVNULL, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return _fail(f"the virtual machine did not end within {LIMIT_S} s")
    status = shared / "status"
    return int(status.read_text()) if status.exists() else _fail("the virtual machine died")


def _version(kernel: Path) -> str:
    return next((kernel / "lib" / "modules").iterdir()).name


def _fail(reason: str) -> int:
    sys.stderr.write(f"hardware-vm: {reason}\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
