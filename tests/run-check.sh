#!/bin/bash
# run-check.sh LOGS PART...: runs `make check-PART` for each part, one after the other. A+B,C runs B
# and then C beside A, with the processor time that it leaves: tests that wait for daemons leave
# much. Keeps what a part prints in LOGS/PART.log and shows it. At the end it prints how long each
# part took, the twenty slowest tests, every test that was skipped or has failed, and how many tests
# passed, failed and were skipped; LOGS/failed keeps the names of those that failed, LOGS/total the
# numbers, and LOGS/ran a line for each part: when it ran last, on which commit, how long, and whether
# it passed. Exits 1 when a part has failed. Up to ten failed tests of pytest or cmocka programs run
# once more, each alone: one that passes then is named by a line `flaky: NAME` and does not count as
# failed. With FORBID_SKIPS=yes it also exits 1 when a test was skipped for another reason than that
# ../shared is missing.
set -u
logs=$1
shift
mkdir -p "$logs"
rm -f "$logs"/unit-*.log "$logs"/accuracy-*.log

run_parts() { # NICENESS PART...: of each its log, its exit status and its time in seconds
  local start_ns niceness=$1 part
  shift
  for part in "$@"; do
    start_ns=$(date +%s%N)
    nice -n "$niceness" make --no-print-directory "check-$part" >"$logs/$part.log" 2>&1
    echo "$? $((($(date +%s%N) - start_ns) / 1000000000))" >"$logs/$part.status"
  done
}

parts=
for group in "$@"; do
  niceness=0
  for beside in ${group//+/ }; do
    run_parts $niceness ${beside//,/ } &
    niceness=15
  done
  wait
  for part in ${group//[+,]/ }; do
    parts="$parts $part"
    echo "---- check-$part"
    cat "$logs/$part.log"
  done
done

# The number before a word in the line that sums up pytest's log.
pytest_count() { # PART WORD
  grep -E ' in [0-9.]+s' "$logs/$1.log" | tail -n 1 | grep -oE "[0-9]+ $2" | grep -oE '[0-9]+' || echo 0
}

# Runs a failed test again; its name is that of a line FAILED of the part's log.
run_again() { # PART NAME
  case $1 in
  unit | stacks) timeout 600 "${logs%/*}/tests/$2" ;;
  units-long) UNIT_LONG=yes timeout 600 "${logs%/*}/tests/$2" ;;
  *) TEST=$2 make --no-print-directory check-again ;;
  esac >>"$logs/again.log" 2>&1 </dev/null
}

# Whether all tests that failed in a part pass when each runs alone. Writes those to LOGS/flaky.
all_are_flaky() { # PART
  local names name behind
  case $1 in e2e | services) behind=' - ' ;; unit | units-long | stacks) behind=': ' ;; *) return 1 ;; esac
  names=$(grep -E '^(FAILED|ERROR) ' "$logs/$1.log" | sed -E "s/^[A-Z]+ +//; s/$behind.*//" | sort -u)
  [ -n "$names" ] && [ "$(wc -l <<<"$names")" -le 10 ] || return 1
  while read -r name; do
    run_again "$1" "$name" || return 1
  done <<<"$names"
  sed 's/^/flaky: /' <<<"$names" >>"$logs/flaky"
}

# Puts the line of a part into LOGS/ran.
note_run() { # PART SECONDS STATUS
  local commit outcome=passed
  [ "$3" -eq 0 ] || outcome=FAILED
  commit=$(git describe --always --dirty 2>/dev/null || echo unknown)
  touch "$logs/ran"
  {
    grep -v "^$1 " "$logs/ran"
    echo "$1 $(date -u +%Y-%m-%dT%H:%MZ) $commit $2 s $outcome"
  } >"$logs/ran.new"
  mv "$logs/ran.new" "$logs/ran"
}

passed=0 failed=0 skipped=0 bad=
: >"$logs/flaky"
: >"$logs/skipped"
: >"$logs/failed"
echo "---- time of each part"
for part in $parts; do
  read -r status seconds <"$logs/$part.status"
  if [ "$status" -ne 0 ] && all_are_flaky "$part"; then # they count neither way
    sed -i -E 's/^(FAILED|ERROR) /flaky  /; s/, [0-9]+ (failed|errors?)//; s/[0-9]+ (failed|errors?),? ?//' "$logs/$part.log"
    status=0
  fi
  printf '%-12s %4d s%s\n' "$part" "$seconds" "$([ "$status" -eq 0 ] || echo '  FAILED')"
  note_run "$part" "$seconds" "$status"
  [ "$status" -eq 0 ] || bad="$bad $part"
  case $part in
  unit | units-long | stacks)
    one=$(cat "$logs"/unit-*.log "$logs"/accuracy-*.log |
      awk '$2 == "PASSED" { n += $4 } END { print n + 0 }')
    passed=$((passed + one))
    failed=$((failed + $(grep -c '^FAILED' "$logs/$part.log")))
    ;;
  e2e | services | soak* | tls-long | balancer-long | blender | pipeline | packages | plan | figures)
    passed=$((passed + $(pytest_count "$part" passed)))
    failed=$((failed + $(pytest_count "$part" failed) + $(pytest_count "$part" error)))
    skipped=$((skipped + $(pytest_count "$part" skipped)))
    grep '^SKIPPED' "$logs/$part.log" >>"$logs/skipped"
    ;;
  *)
    # Other parts print one line for each test: `NAME: ...`, with the word skipped for a skipped one.
    one=$(grep -c "^${part%%-*}:.* skipped" "$logs/$part.log")
    skipped=$((skipped + one))
    grep "^${part%%-*}:.* skipped" "$logs/$part.log" >>"$logs/skipped"
    passed=$((passed + (status == 0) - (status == 0 && one > 0)))
    failed=$((failed + (status != 0)))
    ;;
  esac
  if [ "$status" -ne 0 ]; then
    # What names its failures does so by lines such as `FAILED NAME - reason`; of others, the end.
    grep -E '^(FAILED|ERROR) ' "$logs/$part.log" >>"$logs/failed" ||
      tail -n 5 "$logs/$part.log" | sed "s/^/$part: /" >>"$logs/failed"
  fi
done

echo "---- the slowest tests"
for part in $parts; do
  sed -nE 's/^passed +([^ ]+) ([0-9.]+) s$/\2 \1/p; s/^([0-9.]+)s call +/\1 /p' "$logs/$part.log"
done | sort -rn | head -n 20 | while read -r seconds name; do
  printf '%7.1f s  %s\n' "$seconds" "$name"
done

cat "$logs/skipped" "$logs/failed" "$logs/flaky"
if [ "${FORBID_SKIPS-}" = yes ] && grep -v '\.\./shared' "$logs/skipped" >/dev/null; then
  echo "run-check.sh: tests were skipped for other reasons than that ../shared is missing"
  bad="$bad skipped-tests"
fi
echo "$passed passed, $failed failed, $skipped skipped" | tee "$logs/total"
[ -z "$bad" ] || echo "failed:$bad"
[ -z "$bad" ]
