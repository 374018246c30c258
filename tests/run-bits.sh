#!/bin/sh
# run-bits.sh BUILD native|aarch64: compares the bits of a fixed set of requests with those that
# tests/bits/record.txt holds, so that a change of bits is never unseen, in whatever it happens.
# native: on every instruction set of this machine; RECORD=1 records them anew. aarch64: from a
# cross-build that qemu emulates; it needs the Debian packages gcc-aarch64-linux-gnu and qemu-user.
set -eu
build=$1
record=tests/bits/record.txt
mkdir -p "$build/bits"
failed=0

same() { # NAME OTHER EXPECTED FOUND: compares two files
  if cmp -s "$3" "$4"; then
    echo "bits: $1 equals $2 ($(wc -l <"$4") checksums)"
  else
    echo "bits: $1 differs from $2 in:"
    diff "$3" "$4" | sed -n 's/^[<>] \(.*\) [0-9a-f]*$/  \1/p' | awk '!seen[$0]++'
    failed=1
  fi
}

# The model gaussians fits by cminpack, whose bits are not the same on all machines. Fits of layers
# round what it finds; where it is not there, they are left out.
common() {
  grep -v '^gaussians '
}

if [ "$2" = native ]; then
  # All at once: each takes one processor. The first one looks for lost memory, too. SSE2's solutions,
  # as slow as portable ones, are compared beside those of aarch64.
  loads=${PORTABLE_LOADS-}
  for isa in portable sse2.kernels sse2.others avx2 avx512; do
    # shellcheck disable=SC2046  # an instruction set and a part are two words
    { LD_PRELOAD=$loads "$build/tests/bits" $(echo $isa | tr . ' ') >"$build/bits/$isa" && echo 0 || echo $?; } >"$build/bits/$isa.status" &
    loads=
  done
  wait
  (cd "$build/bits" && cat sse2.kernels sse2.others >sse2 && cat sse2.others.status >sse2.status && grep -v '^answers ' portable >most)
  for isa in portable sse2 avx2 avx512; do
    case $(cat "$build/bits/$isa.status") in
    0) case $isa in
      portable) ;;
      sse2) same $isa "portable, without solutions," "$build/bits/most" "$build/bits/$isa" ;;
      *) same $isa portable "$build/bits/portable" "$build/bits/$isa" ;;
      esac ;;
    77) echo "bits: $isa: this machine does not have it" ;;
    *) echo "bits: $isa: the program fails" && failed=1 ;;
    esac
  done
  { common <"$build/bits/portable" && "$build/tests/bits" - layers; } >"$build/bits/common"
  if [ -n "${RECORD-}" ] && [ $failed = 0 ]; then
    cp "$build/bits/common" $record
  fi
  same portable $record $record "$build/bits/common"
  [ $failed = 0 ] || echo "bits: what is meant to change: RECORD=1 make check-bits, and list it in the commit"
  exit $failed
fi

cross=aarch64-linux-gnu-gcc
if command -v $cross >/dev/null 2>&1 && command -v qemu-aarch64 >/dev/null 2>&1; then
  # In place of cminpack, which is not there for it.
  mkdir -p "$build/aarch64"
  echo 'int lmder(void) { return 0; } void covar(void) {}' |
    $cross -x c -c - -o "$build/aarch64/cminpack.o"
  env -u MAKEFLAGS -u MAKELEVEL make -s -j2 BUILD="$build/aarch64" CC=$cross SANITIZE= CFLAGS='-O2' \
    CORE_LIBS="$build/aarch64/cminpack.o" LDFLAGS=-static "$build/aarch64/tests/bits"
  # An emulated processor takes minutes: portable kernels, the same source for both precisions, are
  # asked in one.
  for part in neon.kernels neon.solutions neon.others portable.f64; do
    qemu-aarch64 "$build/aarch64/tests/bits" ${part%.*} ${part#*.} | common >"$build/bits/aarch64-$part" &
  done
  wait
  (cd "$build/bits" && cat aarch64-neon.kernels aarch64-neon.solutions aarch64-neon.others) >"$build/bits/aarch64-neon"
  grep -v '^fits layers' $record >"$build/bits/solved"
  same "aarch64 neon" $record "$build/bits/solved" "$build/bits/aarch64-neon"
  awk 'NF == 5 && $2 == "f64"' $record >"$build/bits/f64"
  same "aarch64 portable" "that in double precision" "$build/bits/f64" "$build/bits/aarch64-portable.f64"
  if [ "$(uname -m)" = x86_64 ]; then
    grep '^answers ' $record >"$build/bits/answers"
    "$build/tests/bits" sse2 solutions >"$build/bits/sse2.solutions"
    same "sse2 solutions" "those of $record" "$build/bits/answers" "$build/bits/sse2.solutions"
  fi
else
  echo "bits: aarch64 skipped: the packages gcc-aarch64-linux-gnu and qemu-user are not installed"
fi
exit $failed
