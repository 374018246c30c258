#!/bin/sh
# run-units.sh PROGRAM...: runs each test program by itself, from the repository's top. Shows what a
# program printed when it fails, and always for the accuracy tests, whose tables of errors are a
# result. Exits 1 when any has failed, after all have been run.
set -u
limit_s=${UNIT_LIMIT_S:-600}
start=$PWD
cd "$(dirname "$0")/.." || exit 1
output=$(mktemp) || exit 1
trap 'rm -f "$output"' EXIT
trap 'exit 1' INT TERM

run=0
failed=
for program in "$@"; do
  case $program in
  /*) ;;
  *) program=$start/$program ;;
  esac
  name=$(basename "$(dirname "$program")")/$(basename "$program")
  run=$((run + 1))
  timeout "$limit_s" "$program" >"$output" 2>&1 </dev/null
  status=$?
  case $status in
  0) echo "passed  $name" ;;
  124) echo "FAILED  $name: not done after $limit_s s" ;;
  *) echo "FAILED  $name: exit status $status" ;;
  esac
  [ $status -eq 0 ] || failed="$failed $name"
  case $status:$name in
  0:accuracy/*) sed 's/^/        /' "$output" ;;
  0:*) ;;
  *) sed 's/^/        /' "$output" ;;
  esac
done

if [ "$run" -eq 0 ]; then
  echo "run-units.sh: no test programs were named" >&2
  exit 1
fi
if [ -n "$failed" ]; then
  echo "$run test programs, failed:$failed"
  exit 1
fi
echo "$run test programs, all passed"
