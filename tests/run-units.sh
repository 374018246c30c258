#!/bin/bash
# run-units.sh FOLDER PROGRAM...: runs each test program, as many at a time as this machine has
# processors. What a program prints goes into a log of its own in FOLDER. Shows the log of each
# program that fails, and always those of the accuracy tests, whose tables of errors are a result.
# A program may take UNIT_LIMIT_S seconds of a processor, and five times as long beside other work.
# Exits 1 when a program has failed, after all have run.
set -u
limit_s=${UNIT_LIMIT_S:-600}

if [ "$1" = --one ]; then
  name=$(basename "$(dirname "$3")")/$(basename "$3")
  log=$2/${name/\//-}.log
  start_ns=$(date +%s%N)
  (ulimit -t "$limit_s" && exec timeout "$((5 * limit_s))" "$3") >"$log" 2>&1 </dev/null
  status=$?
  tenths=$((($(date +%s%N) - start_ns) / 100000000))
  {
    case $status in
    0) printf 'passed  %s %d.%d s\n' "$name" $((tenths / 10)) $((tenths % 10)) ;;
    124) echo "FAILED  $name: not done after $((5 * limit_s)) s" ;;
    137 | 152) echo "FAILED  $name: not done after $limit_s s of a processor" ;;
    *) echo "FAILED  $name: exit status $status" ;;
    esac
    case $status:$name in
    0:accuracy/*) sed 's/^/        /' "$log" ;;
    0:*) ;;
    *) sed 's/^/        /' "$log" ;;
    esac
  } >"$log.shown"
  # In one write, so that programs that end at the same time do not mix their lines.
  cat "$log.shown"
  rm -f "$log.shown"
  [ $status -eq 0 ]
  exit
fi

folder=$1
shift
if [ $# -eq 0 ]; then
  echo "run-units.sh: no test programs were named" >&2
  exit 1
fi
mkdir -p "$folder"
if printf '%s\0' "$@" | xargs -0 -n 1 -P "$(nproc)" bash "$0" --one "$folder"; then
  echo "$# test programs, all passed"
else
  echo "$# test programs, some failed: see FAILED above"
  exit 1
fi
