#!/bin/sh
# The demonstration: evaluates measured skin with two dipoles and by radiative transport, as a table
# and as pictures, and says how far they are apart. Each command starts a daemon for itself, which
# ends with it. Usage: demo.sh BUILD_DIR
set -eu

build=${1:?"usage: $0 BUILD_DIR"}
picture=$build/demo/skin1
skin="--medium skin1 --model transport,classical,better --from 0.1 --to 10 --log"

fail() {
  printf 'demo: %s\n' "$*" >&2
  exit 1
}

for program in dipoled dipole; do
  [ -x "$build/$program" ] || fail "$build/$program is not there: run make first"
done
command -v gnuplot >/dev/null || fail "gnuplot is not installed: install the package gnuplot-nox"

evaluate() { # OPTION...: shows a command and runs it
  printf '$ %s/dipole eval %s\n' "$build" "$*"
  DIPOLED= "$build/dipole" eval "$@" || fail "the evaluation failed"
}

# shellcheck disable=SC2086
evaluate $skin --channel red --count 9
evaluate --sigma-a 0.05 --sigma-s 9.5 --g 0.9 --eta 1.4 --tolerance 0.01 --r 0.1,1,5

# The pictures have more radii than a table that people read.
mkdir -p "$build/demo"
# shellcheck disable=SC2086
DIPOLED= "$build/dipole" eval $skin --count 401 --format csv --plot "$picture.svg" \
  --plot "$picture.png" >"$picture.csv" || fail "the pictures could not be drawn"

printf '\nThe three profiles over r, on logarithmic axes:\n'
printf '  %s\n' "$picture.svg" "$picture.png" "$picture.csv"
awk -F, 'NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; next }
  $at["channel"] != "red" { next }
  { model = $at["model"]; r = $at["r"]; R = $at["R"] }
  model == "transport" { transport[r] = R; next } # it comes first
  { off = 100 * (R / transport[r] - 1); off = off < 0 ? -off : off }
  off > most[model] { most[model] = off; where[model] = r }
  r >= 2 && off > beyond[model] { beyond[model] = off }
  END {
    printf "\nIn red, from 0.1 to 10 mm, "
    for (i = split("classical better", dipole, " "); i > 0; i--) {
      model = dipole[3 - i]
      printf "the %s dipole is up to %.0f %% from transport, at %.2g mm, and from 2 mm on up to %.0f %%%s", model,
        most[model], where[model], beyond[model], i == 2 ? "; " : ".\n"
    }
  }' "$picture.csv"
