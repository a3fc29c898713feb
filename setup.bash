# shellcheck shell=bash
# A shell in which everything is on the path: `source setup.bash`, from any folder, as often as
# you like. The set-up itself is `make build`.

if [[ "${BASH_SOURCE[0]}" == "$0" ]]; then
    echo "setup.bash: source it instead (source ${BASH_SOURCE[0]}): it sets up this shell" >&2
    exit 1
fi

_mfpcc_root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" >/dev/null && pwd -P)

# The set-up writes these files last, so without them there is nothing here, or half of it. What it
# made names the folder that it was made in: in a moved or copied one it would start the other's code.
_mfpcc_wrong=
for _mfpcc_file in .venv/.complete install/mfpcc.completion.bash install/.complete; do
    [[ -f "$_mfpcc_root/$_mfpcc_file" ]] || _mfpcc_wrong="nothing is built here yet"
done
if [[ -z "$_mfpcc_wrong" ]]; then
    _mfpcc_made=$(<"$_mfpcc_root/.venv/.complete")
    if [[ "$_mfpcc_made" != *"\"$_mfpcc_root/.venv\""* ]]; then
        _mfpcc_wrong="what is built here was built in another folder, from which this one came"
    elif [[ -n "${ROS_DISTRO:-}" && "$_mfpcc_made" == *'"ros": "PyPI"'* ]]; then
        _mfpcc_wrong="this shell has ROS 2 $ROS_DISTRO, and what is built here brings its own: use \
a shell without ROS_DISTRO, or build it for this one"
    fi
    unset _mfpcc_made
fi
if [[ -n "$_mfpcc_wrong" ]]; then
    echo "setup.bash: $_mfpcc_wrong; run: make -C $(printf %q "$_mfpcc_root") build" >&2
    unset _mfpcc_root _mfpcc_file _mfpcc_wrong
    return 1
fi
unset _mfpcc_file _mfpcc_wrong

# Neither of the two scripts is written for `set -u`.
case $- in
    *u*) _mfpcc_nounset=1; set +u ;;
    *) _mfpcc_nounset= ;;
esac
source "$_mfpcc_root/.venv/bin/activate"
source "$_mfpcc_root/install/setup.bash"
if [[ -n "$_mfpcc_nounset" ]]; then set -u; fi

# The ROS 2 wheels set their library path at the start of each Python, unless this says that it is
# set; inherited from another environment's Python, it would be that one's path.
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE

# `ros2 pkg`, `ros2 interface` and our own look-ups find the wheels' packages by this.
if [[ -d "$VIRTUAL_ENV/share/ament_index" && ":${AMENT_PREFIX_PATH:-}:" != *":$VIRTUAL_ENV:"* ]]; then
    export AMENT_PREFIX_PATH="${AMENT_PREFIX_PATH:+$AMENT_PREFIX_PATH:}$VIRTUAL_ENV"
fi

# A simulated drive has no business on the network unless it is told so.
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"

# Nodes find each other at once rather than within 3 s (the file says why).
export FASTRTPS_DEFAULT_PROFILES_FILE="${FASTRTPS_DEFAULT_PROFILES_FILE:-$_mfpcc_root/config/fastdds.xml}"

# `ros2` is ROS's own where there is one. Otherwise a stand-in, last on the path.
_mfpcc_standin="$_mfpcc_root/install/ros2_standin/share/ros2_standin/path"
if ! type -P ros2 >/dev/null && [[ -d "$_mfpcc_standin" ]]; then
    export PATH="$PATH:$_mfpcc_standin"
fi
unset _mfpcc_standin

# Tab completes `mfpcc`; the set-up wrote how.
source "$_mfpcc_root/install/mfpcc.completion.bash"

unset _mfpcc_root _mfpcc_nounset
