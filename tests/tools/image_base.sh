#!/bin/bash
# Makes the base image that the Dockerfile's FROM line names, where no registry gives it out: Debian bookworm from packages,
# and this machine's Python 3.11 under /usr/local.  usage: image_base.sh NAME   (as root; a minute)
set -eu
name=$1
scratch=$(mktemp -d); trap 'rm -rf "$scratch"' EXIT
buildah="buildah --storage-driver vfs"
home=$(python3.11 -c 'import sys; print(sys.base_prefix)')
root=$scratch/root; mkdir "$root"
packages=ca-certificates,libssl3,libsqlite3-0,libffi8,libbz2-1.0,liblzma5,libreadline8,zlib1g,libncursesw6,netbase,tzdata
mmdebstrap --variant=minbase --include=$packages bookworm "$scratch/base.tar" >"$scratch/log" 2>&1 || { tail -3 "$scratch/log" >&2; exit 2; }
tar xf "$scratch/base.tar" -C "$root"
cp -a "$home/bin" "$home/lib" "$home/include" "$root/usr/local/"
# What this machine trusts, and where its packages come from: a mirror may stand between it and the world.
cp -a /etc/ssl/certs "$root/etc/ssl/"
cp -aL /usr/local/share/ca-certificates/. "$root/usr/local/share/ca-certificates/" 2>/dev/null || true
rm -rf "$root"/etc/apt/sources.list*
cp -a /etc/apt/sources.list* "$root/etc/apt/"
cp -a /etc/apt/apt.conf.d/. "$root/etc/apt/apt.conf.d/"
cd "$root/usr/local/bin"
for program in pip pip3 pip3.11; do [ ! -f $program ] || sed -i '1s|^#!.*|#!/usr/local/bin/python3.11|' $program; done
ln -sf python3.11 python; ln -sf python3.11 python3
python="chroot $root /usr/local/bin/python -m pip"
chroot "$root" /sbin/ldconfig
$python list --format=freeze 2>/dev/null | sed 's/[=@ ].*//' | grep -vE '^(pip|setuptools|wheel)$' | xargs -r $python uninstall -y -q >/dev/null 2>&1 || true
$python install -q wheel setuptools >/dev/null 2>&1
container=$($buildah from scratch)
$buildah copy -q "$container" "$root" / >/dev/null
$buildah config --env PATH=/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin "$container"
$buildah commit -q "$container" "$name" >/dev/null
$buildah rm "$container" >/dev/null
