#!/bin/sh
# R of skin at ten distances, with mbpoll: profile.sh HOST:PORT, or DEVICE,BAUD for a serial line.
# Options of mbpoll: -0 counts registers from 0, as the protocol does; -B takes floats with the most
# significant word first.
set -eu
case ${1?"profile.sh HOST:PORT, or profile.sh DEVICE,BAUD"} in
/*) line="-m rtu -b ${1##*,} -P none -a 1 -0 -1 -q -B" where=${1%,*} ;;
*) line="-m tcp -p ${1##*:} -a 1 -0 -1 -q -B" where=${1%:*} ;;
esac
# $line is not quoted: the shell splits it into options.
# shellcheck disable=SC2086
{
  mbpoll $line -r 106 -t 4:float "$where" 0.032 0.74 0 1.3 >/dev/null            # sigma_a ... eta
  mbpoll $line -r 114 -t 4 "$where" 1 10 >/dev/null                              # a list of 10
  mbpoll $line -r 120 -t 4:float "$where" 0.1 0.2 0.5 1 1.5 2 3 4 6 8 >/dev/null # in mm
  mbpoll $line -r 100 -t 4 "$where" 1 >/dev/null                                 # commit
  mbpoll $line -r 312 -c 10 -t 4:float "$where"                                  # R, 1/mm^2
}
