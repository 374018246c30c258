#!/bin/sh
# run.sh FOLDER: installs the Debian packages in FOLDER in a new, minimal system, boots it, asks the
# daemon that its systemd has started, and takes the packages away again: nothing may be left.
# Needs root, debootstrap and an apt of the release that this machine has; where they are missing it
# says so and does nothing. Where a system cannot be booted (systemd-nspawn), the daemon is started
# by hand.
set -eu
packages=$(cd "$1" && pwd)
here=$(cd "$(dirname "$0")" && pwd)

skip() {
  echo "deb: skipped: $1"
  exit 0
}

[ "$(id -u)" = 0 ] || skip 'only root can make a system'
command -v debootstrap >/dev/null || skip 'debootstrap is not installed'
command -v unshare >/dev/null || skip 'unshare is not installed'
unshare --mount --pid --fork true 2>/dev/null || skip 'namespaces are not allowed here'
release=$(. /etc/os-release && echo "${VERSION_CODENAME-}")
sources=$(apt-get indextargets --format '$(CODENAME) $(REPO_URI)' 'Created-By: Packages' || true)
mirror=$(echo "$sources" | awk -v release="$release" '$1 == release { print $2; exit }')
[ -n "$mirror" ] || skip "apt knows no source for '$release'"

work=$(mktemp -d)
root=$work/root
trap 'rm -rf --one-file-system "$work"' EXIT

# A script of this folder, in the new system.
inside() { # script
  cp "$here/$1" "$root/opt/inside.sh"
  unshare --mount --pid --fork sh -c '
    mount -t proc proc "$1/proc"
    exec chroot "$1" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 \
      sh -eu /opt/inside.sh' sh "$root"
}

quietly() { # what it is, command
  echo "deb: $1"
  shift
  "$@" >"$work/log" 2>&1 || {
    tail -n 40 "$work/log" >&2
    exit 1
  }
}

quietly "a minimal $release" debootstrap --variant=minbase --include=systemd-sysv,dbus \
  "$release" "$root" "$mirror"
# The same sources and keys as here.
rm -rf "$root/etc/apt"
cp -a /etc/apt "$root/etc/apt"
cp -a /usr/share/keyrings/. "$root/usr/share/keyrings/"
cp "$here/listing.sh" "$root/opt/"
mkdir "$root/opt/packages"
cp "$packages"/*.deb "$root/opt/packages/"

quietly 'installing' inside installing.sh
quietly 'what has been installed' inside installed.sh
if command -v systemd-nspawn >/dev/null; then
  cp "$here"/boot* "$root/opt/"
  mkdir "$work/out"
  # The system forgets what happens while it runs.
  quietly 'booting' timeout -k 10 180 systemd-nspawn --quiet --register=no --keep-unit \
    --private-network --volatile=overlay --bind="$work/out:/opt/out" --directory="$root" \
    sh -c 'systemctl --quiet enable /opt/booted.service && exec /sbin/init'
  [ -e "$work/out/good" ] || {
    cat "$work/out/log" >&2
    exit 1
  }
else
  echo 'deb: not booted: systemd-nspawn is not installed'
  quietly 'a daemon started by hand' inside by_hand.sh
fi
quietly 'purging' inside purging.sh
echo 'deb: installed, asked, purged; nothing is left'
