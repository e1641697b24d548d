#!/bin/busybox sh
# The guest's first process: loads modules, makes the host's files its root under an overlay that vanishes, and hands over
# to session.sh. Whatever fails powers the guest off; QEMU's console log says what.
bb=/bin/busybox
fail() { echo "guest: $* failed"; $bb poweroff -f; }
mount_to() { $bb mount -t "$1" -o "$2" "$3" "$4" || fail "mounting $4"; }

mount_to proc rw proc /proc
mount_to sysfs rw sys /sys
mount_to devtmpfs rw dev /dev
for module in /modules/*; do $bb insmod "$module" || fail "loading $module"; done

share=trans=virtio,version=9p2000.L,msize=512000
mount_to 9p $share,ro,cache=loose host /host
mount_to tmpfs size=75% tmpfs /overlay
$bb mkdir /overlay/upper /overlay/work
mount_to overlay lowerdir=/host,upperdir=/overlay/upper,workdir=/overlay/work,xino=off overlay /newroot

mount_to proc rw proc /newroot/proc
mount_to sysfs rw sys /newroot/sys
mount_to devtmpfs rw dev /newroot/dev
$bb mkdir -p /newroot/dev/pts /newroot/dev/shm
mount_to devpts rw devpts /newroot/dev/pts
mount_to tmpfs rw tmpfs /newroot/dev/shm
$bb ln -sf /proc/self/fd /newroot/dev/fd
for stream in 0:stdin 1:stdout 2:stderr; do $bb ln -sf "/proc/self/fd/${stream%:*}" "/newroot/dev/${stream#*:}"; done
mount_to tmpfs rw tmpfs /newroot/run
$bb mkdir -p /newroot/run/job
mount_to 9p $share,cache=none job /newroot/run/job

release=$($bb uname -r)
$bb mkdir -p "/newroot/lib/modules/$release"
$bb mount --bind "/host$($bb cat /modules.host)" "/newroot/lib/modules/$release" || fail "binding modules"
$bb ip link set lo up
$bb hostname guest
exec $bb switch_root /newroot /bin/sh /run/job/session.sh
