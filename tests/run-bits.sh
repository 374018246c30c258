#!/bin/sh
# run-bits.sh BUILD: the same bits from every instruction set of this machine and, when Debian's
# packages gcc-aarch64-linux-gnu and qemu-user are installed, from a build for aarch64.
set -eu
build=$1
mkdir -p "$build/bits"
"$build/tests/bits" portable >"$build/bits/portable"
failed=0

same() { # what file
  if cmp -s "$build/bits/portable" "$2"; then
    echo "bits: $1 equals portable ($(wc -l <"$2") checksums)"
  else
    echo "bits: $1 differs from portable:"
    diff "$build/bits/portable" "$2" | head -n 10
    failed=1
  fi
}

for isa in sse2 avx2 avx512; do
  if "$build/tests/bits" $isa >"$build/bits/$isa" 2>/dev/null; then
    same $isa "$build/bits/$isa"
  else
    echo "bits: $isa skipped: this machine cannot run it"
  fi
done

cross=aarch64-linux-gnu-gcc
if command -v $cross >/dev/null 2>&1 && command -v qemu-aarch64 >/dev/null 2>&1; then
  env -u MAKEFLAGS -u MAKELEVEL make -s BUILD="$build/aarch64" CC=$cross SANITIZE= CFLAGS='-O2' \
    GSL=no LDFLAGS=-static "$build/aarch64/tests/bits"
  # GSL is this machine's, so the model that needs it is left out.
  qemu-aarch64 "$build/aarch64/tests/bits" portable | grep -v '^gaussians ' >"$build/bits/aarch64"
  grep -v '^gaussians ' "$build/bits/portable" >"$build/bits/common"
  mv "$build/bits/common" "$build/bits/portable"
  same aarch64 "$build/bits/aarch64"
else
  echo "bits: aarch64 skipped: the packages gcc-aarch64-linux-gnu and qemu-user are not installed"
fi
exit $failed
