#!/bin/sh
# container.sh BUILD FOLDER: collects the files of the container image in FOLDER/root: the programs of
# BUILD and the libraries that they are linked to.
set -eu
build=$1
folder=$2
rm -rf "$folder"
mkdir -p "$folder/root/usr/bin"
cp clients/deploy/Containerfile "$folder/"
install -m 755 "$build/dipoled" "$build/dipole" "$folder/root/usr/bin/"
ldd "$build/dipoled" "$build/dipole" | sed -n 's/.*[ \t]\(\/[^ ]*\) (.*/\1/p' | sort -u |
  while read -r library; do
    mkdir -p "$folder/root${library%/*}"
    cp -L "$library" "$folder/root$library"
  done
