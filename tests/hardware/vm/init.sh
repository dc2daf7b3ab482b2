#!/bin/busybox sh
# First program of the virtual machine: the host's root, read-only below a layer in memory, becomes
# its own; then /mnt/out/command.sh runs in it.
B=/bin/busybox
$B mount -t proc proc /proc
$B mount -t sysfs sys /sys
$B mount -t devtmpfs dev /dev
for module in /modules/*.ko; do $B insmod "$module"; done
SHARE=trans=virtio,version=9p2000.L,msize=1048576
$B mkdir -p /lower /layer
$B mount -t 9p -o $SHARE,cache=loose,ro hostroot /lower || { echo "vm: no root over 9p"; $B poweroff -f; }
$B mount -t tmpfs tmpfs /layer
$B mkdir -p /layer/upper /layer/work
$B mount -t overlay -o lowerdir=/lower,upperdir=/layer/upper,workdir=/layer/work overlay /root ||
    { echo "vm: no overlay"; $B poweroff -f; }
$B mount -t proc proc /root/proc
$B mount -t sysfs sys /root/sys
$B mount -t devtmpfs dev /root/dev
$B mkdir -p /root/dev/pts /root/dev/shm /root/mnt/out
$B mount -t devpts devpts /root/dev/pts
$B mount -t tmpfs shm /root/dev/shm
$B mount -t tmpfs run /root/run
$B mount -t 9p -o $SHARE,cache=none hostout /root/mnt/out
$B ip link set lo up
$B chroot /root /bin/bash /mnt/out/command.sh
echo $? > /root/mnt/out/status
$B sync
$B poweroff -f
