#!/usr/bin/env bash
# All tests, or those that the arguments, which are pytest's, choose: first what only computes, then what measures time or talks to nodes and a
# browser in real time, each two at a time. What failed is asked again by itself, twice at most, because machines are shared and slow at times;
# the log shows each time. COVERAGE=1 traces the first part.
set -uo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
cache=$(mktemp -d)
trap 'rm -rf "$cache"' EXIT
pytest=(.venv/bin/python -m pytest -o "cache_dir=$cache")
failed=0
chosen=0

part() {
  "${pytest[@]}" "$@"
  case $? in
    0) chosen=1 ;;
    1) chosen=1 failed=1 ;;
    5) ;; # the arguments choose none of this part
    *) exit 2 ;;
  esac
}

export ROS_PYTHON_CHECK_FIELDS=1
coverage=()
[[ -z ${COVERAGE:-} ]] || coverage=(--cov --cov-report=term:skip-covered)
part -m "not timed" -n 2 --dist loadfile "${coverage[@]}" "$@"
part -m timed -n 2 --dist loadfile "$@"
[[ $chosen == 1 ]] || { echo "tests: the arguments choose none" >&2 && exit 5; }
for time in first second; do
  [[ $failed == 1 ]] || exit 0
  echo "tests: what has failed, by itself, for the $time time"
  failed=0
  part --last-failed --last-failed-no-failures none "$@"
done
exit "$failed"
