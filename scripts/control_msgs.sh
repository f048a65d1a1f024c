#!/usr/bin/env bash
# Generate control_msgs' FollowJointTrajectory into .venv, where that is without it: for the tests of `controller: jtc_action`.
# The ROS wheels have the generators but no control_msgs; where ROS 2 is sourced, `apt install ros-jazzy-control-msgs` is the way.
# Needs a C and a C++ compiler, CMake and Python's headers; says what is missing and ends with 1 otherwise.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
venv=$root/.venv
python=$venv/bin/python
have() { "$python" -c 'from control_msgs.action import FollowJointTrajectory' 2>/dev/null; }
fail() {
  printf 'control_msgs: %s\n' "$@" >&2
  exit 1
}

have && exit 0
[[ -z ${ROS_DISTRO:-} ]] || fail "not installed: apt install ros-jazzy-control-msgs"
# Wheels of another environment must not lend this one their library path.
unset LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE PYTHONPATH
include=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
if [[ ! -e $include/Python.h ]] || ! command -v c++ >/dev/null || ! command -v cc >/dev/null; then
  [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null || fail "needs cc, c++ and $include/Python.h (Debian: build-essential python3-dev)"
  { apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends build-essential python3-dev; } >/dev/null 2>&1 ||
    fail "apt-get could not install build-essential and python3-dev"
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
log=$work/log
say_log() {
  tail -n 15 "$log" >&2
  fail "$1; its last lines are above"
}
echo "control_msgs: generating FollowJointTrajectory (a minute)"
# Their own environment: the generators are of no use to anything else. Versions beyond Jazzy's are kept out by the wheels' own bounds.
base=$("$python" -c 'import sys; print(sys._base_executable)')
"$base" -m venv "$work/venv" >"$log" 2>&1 || say_log "no virtual environment could be made"
parts=(ament-cmake ament-cmake-gmock ament-cmake-gtest ament-cmake-pytest ament-cmake-python ament-cmake-ros ament-package
  common-interfaces python-cmake-module rosidl-core-generators rosidl-default-generators)
"$work/venv/bin/python" -m pip --disable-pip-version-check install --quiet --no-compile 'ros-jazzy-rclpy[fastrtps]' "${parts[@]/#/ros-jazzy-}" \
  'ros-ament-cmake-include-directories==2.5.*' numpy catkin_pkg cmake ninja >>"$log" 2>&1 || say_log "the generators could not be installed"
# The wheels name the Python that they were built with.
grep -rlE '/opt/python/cp3[0-9]+-cp3[0-9]+' "$work"/venv/share/*/cmake | xargs -r sed -i -E \
  -e "s#/opt/python/cp[^/;\"]*/include/python3\.[0-9]+#$include#g" -e "s#/opt/python/cp[^/;\"]*/lib/#$work/venv/lib/#g"
export PATH=$work/venv/bin:$PATH AMENT_PREFIX_PATH=$work/venv VIRTUAL_ENV=$work/venv
cmake -G Ninja -S "$root/test/interfaces/control_msgs" -B "$work/build" -DCMAKE_PREFIX_PATH="$work/venv" -DCMAKE_INSTALL_PREFIX="$venv" \
  -DBUILD_TESTING=OFF -DPython3_EXECUTABLE="$work/venv/bin/python" >>"$log" 2>&1 || say_log "CMake failed"
cmake --build "$work/build" --target install >>"$log" 2>&1 || say_log "the build failed"
unset AMENT_PREFIX_PATH VIRTUAL_ENV
have || fail "it was built, but cannot be imported"
