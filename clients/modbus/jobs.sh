#!/bin/sh
# One of the longer jobs of a unit, with mbpoll, as jobs.py does it with pymodbus: jobs.sh HOST:PORT
# JOB, or jobs.sh DEVICE,BAUD JOB for a serial line. JOB is sample, invert, mc or fit. Ctrl-C cancels it.
# After fit may follow g, the scale, and eta (the refractive index inside over outside) with readings:
# MM,READING,ERROR for each distance.
set -eu
usage="jobs.sh HOST:PORT|DEVICE,BAUD sample|invert|mc
jobs.sh HOST:PORT|DEVICE,BAUD fit [g=0] [scale=absolute|free] [eta=X MM,READING,ERROR...]"

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
job=${2-} g=0 g_from=" (default)" eta='' scale=absolute scale_from=" (default)"
[ $# -lt 2 ] || shift 2
case $job in
fit) ;;
sample | invert | mc) [ $# -eq 0 ] || refuse "$1: $job takes nothing more" ;;
*) refuse "${job:-nothing} is given: a job is sample, invert, mc or fit" ;;
esac
left=$#
while [ "$left" -gt 0 ]; do # the readings stay as arguments
  case $1 in
  g=?*) g=${1#*=} g_from= ;;
  eta=?*) eta=${1#*=} ;;
  scale=absolute | scale=free) scale=${1#*=} scale_from= ;;
  *=*) refuse "$1: fit takes g=X, eta=X, and scale=absolute or scale=free" ;;
  *,*,*,* | *[!0-9.,eE+-]*) refuse "$1: give MM,READING,ERROR" ;;
  ?*,?*,?*) set -- "$@" "$1" ;;
  *) refuse "$1: give MM,READING,ERROR" ;;
  esac
  shift
  left=$((left - 1))
done
if [ $# -eq 0 ]; then
  set -- 1,.02292,.00046 2,.00781,.00016 3,.00343,.00007 5,.000775,.000016
  eta=${eta:-1.4}
fi
[ "$eta" ] || refuse "give eta=X: a wrong eta gives wrong coefficients that fit as well"
for number in "$g" "$eta"; do
  case $number in *[!0-9.eE+-]*) refuse "'$number' is no number" ;; esac
done

# register TYPE ADDRESS VALUE...: writes. $line is not quoted: the shell splits it into options.
# shellcheck disable=SC2086
register() {
  type=$1 address=$2
  shift 2
  mbpoll $line -r "$address" -t "$type" -- "$where" "$@" >/dev/null 2>&1 && return
  echo "error $(number 302) at register $(number 303)" >&2
  exit 1
}

# show TYPE ADDRESS COUNT: reads, and prints lines such as "[4440]: 0.04".
# shellcheck disable=SC2086
show() {
  mbpoll $line -r "$2" -c "$3" -t "$1" "$where" | grep '^\['
}

number() { # the value of one register
  show 4 "$1" 1 | sed 's/^\[[0-9]*\]:[[:space:]]*\([0-9]*\).*/\1/'
}

run() { # run COMMIT STATUS: `cancel` follows `commit`, and `done` follows `status`
  token=$(($(number $(($2 + 1))) % 65535 + 1)) # not that of the job that was done last
  cancel=$(($1 + 1))
  trap 'register 4 $cancel 1; echo cancelled >&2; exit 1' INT
  register 4 "$1" "$token"
  while state=$(number "$2") && [ "$state" = 1 ]; do sleep 0.1; done
  if [ "$state" = 5 ]; then # fit_status_name: two characters in each register
    name=$(show 4 8460 8 | awk '{ printf "%c%c", $2 / 256, $2 % 256 }' | tr -d '\0')
    echo "the fit is no success: $name" >&2
    exit 1
  fi
  if [ "$state" != 2 ] || [ "$(number $(($2 + 1)))" != "$token" ]; then
    echo "status $state, error $(number $(($2 + 2))) at register $(number $(($2 + 3)))" >&2
    exit 1
  fi
}

register 4 251 1                      # defaults: other masters may have left anything
register 4:float 106 0.032 0.74 0 1.3 # sigma_a, sigma_s, g, eta of skin
case $job in
sample)
  register 4 4304 2 10 # the draw regular, ten radii
  run 4300 4420
  show 4:float 4440 10 # radii in mm
  ;;
invert)
  register 4 4704 1 3                 # mean free paths are given, of three media
  register 4:float 4706 0.44 0.22 0.13 # albedos
  register 4:float 4806 1.3 0.95 0.67  # mm
  run 4700 4920
  show 4:float 4940 3 # sigma_a, 1/mm
  show 4:float 5040 3 # sigma_s
  ;;
mc)
  register 4:float 116 0.1 10  # from 0.1 to 10 mm
  register 4 5302 5 3          # five rings, logarithmic
  register 4:float 5304 1e6    # photons
  register 4 5306 0 1          # seed
  run 5300 5320
  show 4:float 5366 6 # edges of the rings in mm
  show 4:float 5468 5 # R, 1/mm^2
  show 4:float 5568 5 # its standard errors
  ;;
fit)
  at=$(for one; do echo "${one%%,*}"; done)
  readings=$(for one; do echo "${one#*,}" | tr , ' '; done)
  register 4 101 29          # the model transport
  register 4:float 110 "$g" "$eta"
  register 4 8001 "$([ "$scale" = free ] && echo 2 || echo 1)"
  # Places are written once, and readings each time. The shell splits the lists into numbers.
  # shellcheck disable=SC2086
  register 4 8015 $# && register 4:float 8016 $at && register 4:float 8204 $readings
  run 8200 8320
  show 4:float 8328 4 # sigma_a, sigma_s' and their standard errors, 1/mm
  show 4:float 8338 1 # chi-squared
  [ "$scale" = absolute ] || show 4:float 8342 2 # the factor and its standard error
  # shellcheck disable=SC2046
  set -- $(show 4:float 8410 2 | sed 's/.*://')
  echo "with g $1$g_from, eta $2, scale $scale$scale_from"
  ;;
esac
