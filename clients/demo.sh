#!/bin/sh
# The demonstration: a daemon on a temporary socket evaluates measured skin with two dipoles and by
# radiative transport, as a table and as pictures, and says how far they are apart. Usage: demo.sh BUILD_DIR
set -eu

build=${1:?"usage: $0 BUILD_DIR"}
medium=skin1
models=transport,classical,better # transport first: the sentence at the end compares with it
daemon=
folder=

say() { printf '%s\n' "$*"; }
fail() {
  printf 'demo: %s\n' "$*" >&2
  exit 1
}

clean_up() {
  status=$?
  trap - EXIT INT TERM HUP
  if [ -n "$daemon" ]; then
    kill -TERM "$daemon" 2>/dev/null || true
    wait "$daemon" 2>/dev/null || true
  fi
  if [ -n "$folder" ]; then
    [ "$status" -eq 0 ] || cat "$folder/dipoled.log" >&2 2>/dev/null || true
    rm -rf "$folder"
  fi
  exit "$status"
}
trap clean_up EXIT
trap 'exit 129' HUP
trap 'exit 130' INT
trap 'exit 143' TERM

for program in dipoled dipole; do
  [ -x "$build/$program" ] || fail "$build/$program is not there: run make first"
done
command -v gnuplot >/dev/null || fail "gnuplot is not installed: install the package gnuplot-nox"

folder=$(mktemp -d)
address=unix:$folder/dipoled.sock
"$build/dipoled" --listen "$address" 2>"$folder/dipoled.log" &
daemon=$!

# Ready when it replies; it has ten seconds to get there.
tries=100
until "$build/dipole" info --connect "$address" --retry-ms 0 >/dev/null 2>&1; do
  kill -0 "$daemon" 2>/dev/null || fail "the daemon ended before it was ready"
  tries=$((tries - 1))
  [ "$tries" -gt 0 ] || fail "the daemon was not ready after 10 seconds"
  sleep 0.1
done

mkdir -p "$build/demo"
radii="--from 0.1 --to 10 --log --count"
say "\$ $build/dipole eval --medium $medium --channel red --model $models $radii 9"
# shellcheck disable=SC2086
"$build/dipole" eval --connect "$address" --medium "$medium" --channel red --model "$models" \
  $radii 9 || fail "the evaluation failed"

say "\$ $build/dipole eval --sigma-a 0.05 --sigma-s 9.5 --g 0.9 --eta 1.4 --tolerance 0.01 --r 0.1,1,5"
"$build/dipole" eval --connect "$address" --sigma-a 0.05 --sigma-s 9.5 --g 0.9 --eta 1.4 \
  --tolerance 0.01 --r 0.1,1,5 || fail "tissue with g = 0.9 got no reply"

# The pictures have more radii than a table that people read.
# shellcheck disable=SC2086
"$build/dipole" eval --connect "$address" --medium "$medium" --model "$models" $radii 401 --format csv \
  --plot "$build/demo/$medium.svg" --plot "$build/demo/$medium.png" \
  >"$build/demo/$medium.csv" || fail "the pictures could not be drawn"

kill -TERM "$daemon" || fail "the daemon was gone before it was stopped"
status=0
wait "$daemon" || status=$?
daemon=
[ "$status" -eq 0 ] || fail "the daemon ended with status $status instead of 0"

say
say "The three profiles over r, on logarithmic axes:"
for file in svg png csv; do
  [ -s "$build/demo/$medium.$file" ] || fail "$build/demo/$medium.$file was not written"
  say "  $build/demo/$medium.$file"
done
say
awk -F, 'NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; next }
  $at["channel"] != "red" { next }
  { model = $at["model"]; r = $at["r"]; R = $at["R"] }
  model == "transport" { transport[r] = R; next }
  { off = 100 * (R / transport[r] - 1); off = off < 0 ? -off : off }
  off > most[model] { most[model] = off; where[model] = r }
  r >= 2 && off > beyond[model] { beyond[model] = off }
  END {
    printf "In red, from 0.1 to 10 mm, "
    for (i = split("classical better", dipole, " "); i > 0; i--) {
      model = dipole[3 - i]
      printf "the %s dipole is up to %.0f %% from transport, at %.2g mm, and from 2 mm on up to %.0f %%%s", model,
        most[model], where[model], beyond[model], i == 2 ? "; " : ".\n"
    }
  }' "$build/demo/$medium.csv"
