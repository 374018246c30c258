#!/bin/sh
# run-bits.sh BUILD native|aarch64: compares the bits of a fixed set of requests with those of the
# portable kernels. native: on every instruction set of this machine. aarch64: from a cross-build
# that qemu emulates; it needs the Debian packages gcc-aarch64-linux-gnu and qemu-user.
set -eu
build=$1
mkdir -p "$build/bits"
failed=0

same() { # NAME EXPECTED FOUND: compares two files
  if cmp -s "$2" "$3"; then
    echo "bits: $1 equals portable ($(wc -l <"$3") checksums)"
  else
    echo "bits: $1 differs from portable:"
    diff "$2" "$3" | head -n 10
    failed=1
  fi
}

if [ "$2" = native ]; then
  # All at once: each takes one processor.
  for isa in portable sse2 avx2 avx512; do
    { "$build/tests/bits" $isa >"$build/bits/$isa" && echo 0 || echo $?; } >"$build/bits/$isa.status" &
  done
  wait
  for isa in portable sse2 avx2 avx512; do
    case $(cat "$build/bits/$isa.status") in
    0) [ $isa = portable ] || same $isa "$build/bits/portable" "$build/bits/$isa" ;;
    77) echo "bits: $isa: this machine does not have it" ;;
    *) echo "bits: $isa: the program fails" && failed=1 ;;
    esac
  done
  exit $failed
fi

cross=aarch64-linux-gnu-gcc
if command -v $cross >/dev/null 2>&1 && command -v qemu-aarch64 >/dev/null 2>&1; then
  # In place of cminpack, which is not there for it: the model gaussians is not compared.
  mkdir -p "$build/aarch64"
  echo 'int lmder(void) { return 0; } void covar(void) {}' |
    $cross -x c -c - -o "$build/aarch64/cminpack.o"
  env -u MAKEFLAGS -u MAKELEVEL make -s -j2 BUILD="$build/aarch64" CC=$cross SANITIZE= CFLAGS='-O2' \
    CORE_LIBS="$build/aarch64/cminpack.o" LDFLAGS=-static "$build/aarch64/tests/bits"
  "$build/tests/bits" portable >"$build/bits/portable"
  grep -v '^gaussians ' "$build/bits/portable" >"$build/bits/common"
  for isa in portable neon; do
    qemu-aarch64 "$build/aarch64/tests/bits" $isa | grep -v '^gaussians ' >"$build/bits/aarch64-$isa" &
  done
  wait
  for isa in portable neon; do
    same "aarch64 $isa" "$build/bits/common" "$build/bits/aarch64-$isa"
  done
else
  echo "bits: aarch64 skipped: the packages gcc-aarch64-linux-gnu and qemu-user are not installed"
fi
exit $failed
