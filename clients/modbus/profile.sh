#!/bin/sh
# R of skin at ten distances, with mbpoll: profile.sh HOST:PORT [MODEL], or profile.sh DEVICE,BAUD
# [MODEL] for a serial line. MODEL is an id of the list of models in REGISTERS.md.
# Options of mbpoll: -0 counts registers from 0, as the protocol does; -B takes floats with the most
# significant word first.
set -eu
usage="profile.sh HOST:PORT [MODEL], or profile.sh DEVICE,BAUD [MODEL]
MODEL is an id of the list of models in REGISTERS.md (default: 2)"
refuse() { # WHAT: is wrong with the command line
  printf '%s\n%s\n' "$1" "$usage" >&2
  exit 2
}
for word; do
  case $word in -h | --help) echo "$usage" && exit ;; esac
done
case ${1-} in
/*,*[0-9]) line="-m rtu -b ${1##*,} -P none -a 1 -0 -1 -q -B" where=${1%,*} ;;
?*:*[0-9]) line="-m tcp -p ${1##*:} -a 1 -0 -1 -q -B" where=${1%:*} ;;
*) refuse "${1:-nothing} is given: give HOST:PORT or DEVICE,BAUD" ;;
esac
model=${2-2}
case $model in '' | *[!0-9]*) refuse "'$model': give the id of a model, a number such as 2" ;; esac
[ $# -le 2 ] || refuse "$3 is one word too many"

# register TYPE ADDRESS VALUE...: writes. $line is not quoted: the shell splits it into options.
# shellcheck disable=SC2086
register() {
  type=$1 address=$2
  shift 2
  mbpoll $line -r "$address" -t "$type" -- "$where" "$@" >/dev/null 2>&1
}

# show TYPE ADDRESS COUNT: reads, and prints lines such as "[312]: 0.04".
# shellcheck disable=SC2086
show() {
  mbpoll $line -r "$2" -c "$3" -t "$1" "$where"
}

number() { # the value of one register, or of TYPE
  show "${2-4}" "$1" 1 | sed -n 's/^\[[0-9]*\]:[[:space:]]*\([^[:space:]]*\).*/\1/p'
}

fail() { # error_text has two characters in each register
  codes=$(show 4:hex 620 40 | sed -n 's/^\[[0-9]*\]:[[:space:]]*0x\(..\)\(..\).*/\1 \2/p')
  text=$(for code in $codes; do
    # shellcheck disable=SC2059
    [ "$code" = 00 ] || printf "\\$(printf %03o "0x$code")"
  done)
  echo "error $(number 302) at register $(number 303): $text" >&2
  exit 1
}

register 4 251 1 || fail                      # defaults: other masters may have left anything
register 4 101 "$model" || fail               # the evaluator stays f32, the moments exact
register 4:float 106 0.032 0.74 0 1.3 || fail # sigma_a, sigma_s, g, eta
register 4 115 10 || fail                     # a list of ten distances
register 4:float 120 0.1 0.2 0.5 1 1.5 2 3 4 6 8 || fail # in mm
token=$(($(number 301) % 65535 + 1)) # not that of the job that was done last
tries=0
until register 4 100 "$token"; do # commit
  tries=$((tries + 1))
  # 10: another master's job is under way; 0: it has ended since
  case $(number 302) in 0 | 10) ;; *) fail ;; esac
  [ $tries -lt 200 ] || fail
  sleep 0.1
done
while state=$(number 300) && [ "$state" = 1 ]; do sleep 0.05; done
[ "$state" = 2 ] || fail
if [ "$(number 301)" != "$token" ]; then
  echo "another master's job has taken the place of $token" >&2
  exit 1
fi
show 4:float 312 10 # R, 1/mm^2
echo "model $(number 306), model error $(number 310 4:float) against radiative transport"
