#!/usr/bin/env bash
# Set everything up: system libraries, .venv in the project's root, dependencies, the package itself (editable), its kernels compiled.
# Safe to call again at any time: it returns at once when nothing has changed. `make setup`, `make demo` and `make test` call it.
#
# setup.sh            what the planner, the demo and the 3-D page need
# setup.sh test       and what the tests and the experiments need
# setup.sh docs       and what the documentation needs
#
# PYTHON=/path/to/python3.12   use this interpreter
# Where a ROS 2 Jazzy is sourced (ROS_DISTRO=jazzy), the venv sees its packages and no ROS wheels are installed.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"
venv=$root/.venv
stamp=$venv/.setup-stamp
partial=$venv/.setup-incomplete
group=${1:-base}

# The ROS wheels leave their library path to child processes; that of another environment must not reach this one's.
if [[ -n ${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-} ]]; then unset LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE; fi

say() { printf 'setup: %s\n' "$*"; }
fail() {
  printf 'setup: %s\n' "$@" >&2
  exit 1
}

# ROS 2 Jazzy sourced? Its Python packages are seen through PYTHONPATH and the system's site-packages.
ros=wheels
if [[ -n ${AMENT_PREFIX_PATH:-} && -n ${ROS_DISTRO:-} ]]; then
  [[ $ROS_DISTRO == jazzy ]] || fail "ROS 2 $ROS_DISTRO is sourced, but this package is for Jazzy." \
    "Start a shell that has not sourced it, or source /opt/ros/jazzy/setup.bash."
  ros=sourced
fi

# What the set-up depends on: when none of it has changed, nothing is to be done.
wanted=$(
  sha256sum setup.py setup.cfg pyproject.toml package.xml scripts/* | sha256sum | cut -c1-32
  printf '%s\n' "$root" "ros: $ros"
)
right_version() { "$1" -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' >/dev/null 2>&1; }
base_of() { "$1" -c 'import sys; print(sys.base_prefix)' 2>/dev/null; }
case $group in
  base) extras=bags,completion,viewer ;;
  docs) extras=bags,completion,viewer,docs ;;
  test) extras=bags,completion,viewer,video,experiments,cluster,bench,docs,test,colcon ;;
  *) fail "what to set up is one of base, test, docs, not $group" ;;
esac
up_to_date() {
  # The stamp holds what it was made for, and then the groups that are there; the tests' holds the others'.
  [[ -f $stamp && ! -e $partial && $(head -n 3 "$stamp") == "$wanted" ]] && right_version "$venv/bin/python" || return 1
  grep -qx -e "group: $group" -e "group: test" "$stamp" || return 1
  [[ -z ${PYTHON:-} || $(base_of "$venv/bin/python") == "$(base_of "$PYTHON")" ]]
}

up_to_date && exit 0
exec 9<"${BASH_SOURCE[0]}" # two `make` at the same time: the second waits for the first
if command -v flock >/dev/null && ! flock --nonblock 9; then
  say "another set-up is running here; waiting for it"
  flock 9
fi
up_to_date && exit 0

# --- Python ------------------------------------------------------------------------------------------------------------------
usable() {
  # 3.11 or 3.12, and where ROS is sourced the interpreter that its rclpy was built for.
  right_version "$1" || return 1
  [[ $ros == wheels ]] || "$1" -c 'import rclpy' >/dev/null 2>&1
}
has_venv() { "$1" -c 'import ensurepip, venv' >/dev/null 2>&1; }
find_python() {
  # The first usable one that can make virtual environments, else the first usable one.
  local candidate second= candidates=(/usr/bin/python3 python3 python3.12 python3.11 /usr/bin/python3.12 /usr/bin/python3.11)
  [[ -z ${PYTHON:-} ]] || candidates=("$PYTHON")
  for candidate in "${candidates[@]}"; do
    command -v "$candidate" >/dev/null && usable "$candidate" || continue
    candidate=$("$candidate" -c 'import sys; print(sys.executable)')
    if has_venv "$candidate"; then
      echo "$candidate"
      return
    fi
    second=${second:-$candidate}
  done
  [[ -n $second ]] && echo "$second"
}

# --- System packages ---------------------------------------------------------------------------------------------------------
has_library() { { PATH=$PATH:/sbin:/usr/sbin ldconfig -p || true; } 2>/dev/null | grep -F "$1" >/dev/null; }
missing_packages() {
  local python
  if python=$(find_python); then
    has_venv "$python" || echo python3-venv
  elif [[ $ros == wheels && -z ${PYTHON:-} ]]; then
    echo python3 python3-venv
  fi
  # Open3D links to these.
  has_library libusb-1.0.so.0 || echo libusb-1.0-0
  has_library libGL.so.1 || echo libgl1
  has_library libgomp.so.1 || echo libgomp1
}
install_packages() {
  local packages=$1 sudo=()
  local advice="Install them (as root: apt-get update && apt-get install -y $packages) and run this again."
  command -v apt-get >/dev/null || fail "These system packages are missing (Debian's names): $packages." "Install them with your package manager and run this again."
  if [[ $(id -u) != 0 ]]; then
    if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
      sudo=(sudo -n)
    else
      fail "These system packages are missing: $packages." "$advice"
    fi
  fi
  say "installing system packages: $packages"
  # shellcheck disable=SC2086  # a list of words
  "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $packages >/dev/null 2>&1 || {
    "${sudo[@]}" apt-get update -q >/dev/null || fail "apt-get update failed (is there a network?)." "$advice"
    "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $packages >/dev/null ||
      fail "apt-get could not install: $packages." "$advice"
  }
}

packages=$(missing_packages | xargs)
[[ -z $packages ]] || install_packages "$packages"
if ! python=$(find_python); then
  if [[ $ros == sourced ]]; then
    fail "ROS 2 Jazzy is sourced, but no Python 3.11 or 3.12 here can import its rclpy${PYTHON:+ (PYTHON=$PYTHON)}." \
      "Install ros-jazzy-rclpy and use the system's python3, or start a shell that has not sourced ROS: then the wheels are used."
  fi
  fail "No Python 3.11 or 3.12 was found${PYTHON:+ at PYTHON=$PYTHON}; Debian 12 and Ubuntu 24.04 have one as python3." \
    "Install one and name it: make setup PYTHON=/path/to/python3.12"
fi

# --- The virtual environment -------------------------------------------------------------------------------------------------
fits() {
  # Complete, alive, in this folder, and with the view of the system's packages that the ROS mode needs.
  [[ ! -e $partial ]] && right_version "$venv/bin/python" && "$venv/bin/python" -m pip --version >/dev/null 2>&1 || return 1
  [[ $("$venv/bin/python" -c 'import sys; print(sys.prefix)') == "$venv" ]] || return 1
  head -n 3 "$venv/bin/pip" 2>/dev/null | grep -qF "$venv/" || return 1 # in a folder with a space it is the second line
  local system=false
  [[ $ros == wheels ]] || system=true
  grep -qi "^include-system-site-packages = $system" "$venv/pyvenv.cfg" || return 1
  [[ -z ${PYTHON:-} || $(base_of "$venv/bin/python") == "$(base_of "$python")" ]]
}
if [[ -e $venv ]] && ! fits; then
  say "the .venv found here is incomplete, broken or of another kind: making it anew"
  rm -rf "$venv"
fi
if [[ ! -e $venv ]]; then
  say "making .venv with $("$python" --version) ($python)"
  options=()
  [[ $ros == wheels ]] || options=(--system-site-packages)
  mkdir -p "$venv" && : >"$partial"
  "$python" -m venv "${options[@]}" "$venv" >/dev/null ||
    fail "Python could not make a virtual environment; on Debian and Ubuntu: apt-get install python3-venv"
fi
: >"$partial"

# --- Dependencies and the package --------------------------------------------------------------------------------------------
log=$venv/setup.log
: >"$log"
install() {
  # Only what takes long is shown: the large downloads, and the unpacking.
  # Modules are compiled when they are first used: most never are, and they would take 0.3 GB.
  "$venv/bin/python" -m pip --disable-pip-version-check install --progress-bar off --no-compile "$@" 2>&1 | tee -a "$log" |
    sed -unE -e 's/^ *Downloading ([^ ]*\/)?([A-Za-z0-9_]+)-[^ ]* (\([0-9]{2,}\.[0-9] MB\)).*/setup:   downloading \2 \3/p' \
      -e 's/^Installing collected packages: .*,.*/setup:   unpacking/p' && return
  tail -n 15 "$log" >&2
  fail "pip could not install the dependencies; its last lines are above, the whole of it in $log." \
    "Without a network nothing can be downloaded; behind a mirror set PIP_INDEX_URL." \
    "Then run this again: what was downloaded is kept in pip's cache."
}
case $group in
  test) size="about 0.7 GB to download, 2.8 GB on disk" ;;
  *) size="about 0.5 GB to download, 2.1 GB on disk" ;;
esac
if [[ $ros == wheels ]]; then
  unset PYTHONPATH
  say "installing the package and its dependencies ($size)"
  install --editable ".[ros,$extras]"
else
  say "ROS 2 Jazzy is sourced: its packages are used, no ROS wheels are installed"
  say "installing the package and its other dependencies ($size at most)"
  install --no-deps --editable .
  "$venv/bin/python" scripts/requirements_beside_ros.py "$extras" >"$venv/requirements.txt"
  install --requirement "$venv/requirements.txt"
fi

# --- The kernels ---------------------------------------------------------------------------------------------------------------
# Once for each version, into the user's cache; every later start, and other checkouts, find them there.
say "compiling the planner (one to three minutes on two cores the first time on this machine, seconds later)"
"$venv/bin/python" -m lime_planner compile 2>&1 | sed -u 's/^/setup:   /' ||
  say "the planner could not be compiled now ($log says why); its first plan will try again"

rm -f "$partial"
{
  printf '%s\n' "$wanted" "group: $group"
  if [[ $group == docs ]]; then echo "group: base"; fi
} >"$stamp"
say "done: $(du -sm "$venv" | awk '{printf "%.1f GB", $1 / 953.7}') in .venv; $("$venv/bin/python" --version), ROS from $([[ $ros == wheels ]] && echo wheels || echo "$AMENT_PREFIX_PATH")"
