# Source this in bash: the built workspace on the paths, with the ROS it was built with.
# Without an installed ros2cli it also gives `ros2 run PACKAGE EXECUTABLE [ARGS]`, so that the README reads the same everywhere.
_workspace=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [[ ! -e $_workspace/install/local_setup.bash ]]; then
  echo "workspace: not built yet: run 'make build' in $_workspace" >&2
  return 1
fi
. "$_workspace/.venv/bin/activate"
if [[ $(<"$_workspace/.venv/ros") == wheels ]]; then
  export AMENT_PREFIX_PATH=$_workspace/.venv ROS_DISTRO=jazzy
  # The wheels are for trying and learning, not for a robot: nobody on the network needs to hear (docs/security.md).
  export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}
  . "$_workspace/install/local_setup.bash"
else
  . "$_workspace/install/setup.bash"  # the ROS below as well, which a new shell may not have sourced
fi

if ! command -v ros2 >/dev/null; then
  ros2() {
    local prefix
    if [[ ${1:-} != run || $# -lt 3 ]]; then
      echo "ros2: without an installed ROS only 'ros2 run PACKAGE EXECUTABLE [ARGS]' is here" >&2
      return 2
    fi
    prefix=$(python -c 'import sys; from ament_index_python import get_package_prefix as p; print(p(sys.argv[1]))' "$2" 2>/dev/null) \
      || { echo "ros2: no package '$2' in this workspace" >&2; return 1; }
    [[ -x $prefix/lib/$2/$3 ]] || { echo "ros2: no executable '$3'; package '$2' has: $(ls "$prefix/lib/$2" 2>/dev/null | xargs)" >&2; return 1; }
    if ((BASHPID == $$)); then
      "$prefix/lib/$2/$3" "${@:4}"
      return
    fi
    # In the background or a pipe bash runs this function as a process of its own: who ends that one means the node.
    local node code=0
    (trap - INT; exec "$prefix/lib/$2/$3" "${@:4}") <&0 &
    node=$!
    trap 'kill "$node" 2>/dev/null' TERM HUP QUIT
    trap 'kill -INT "$node" 2>/dev/null' INT
    wait "$node" || code=$?
    while kill -0 "$node" 2>/dev/null; do code=0; wait "$node" || code=$?; done  # a signal may end `wait` before the node
    return "$code"
  }
  export -f ros2
fi
unset _workspace
