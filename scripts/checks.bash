# Sourced by setup and build, in the workspace's folder: what both of them ask first.

# CMake and ament split their lists at these characters, and the search paths at colons.
plain_path() { [[ $PWD != *[[:space:]:\;\#\$\"\'\\\&\(\)]* ]]; }
path_words() { printf "the folder '%s' has a space or one of : ; # \$ \" ' \\ & ( ) in its path, which ROS's CMake files do not stand: move the workspace" "$PWD"; }

# A workspace that was set up beside an installed ROS needs it in shells where it is not sourced, too.
source_known_ros() {
  if [[ -z ${ROS_DISTRO:-} && -e .venv/ros && $(<.venv/ros) == apt && -e /opt/ros/jazzy/setup.bash ]]; then
    set +u  # ROS's own scripts read variables that are not set
    . /opt/ros/jazzy/setup.bash
    set -u
  fi
}
