# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
# Sourced (bash): puts the environment made by tools/setup.py in place.

_mixtac_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [ -n "${ROS_DISTRO:-}" ] && [ -d "$_mixtac_root/.venv-ros" ]; then
    _mixtac_venv=$_mixtac_root/.venv-ros
else
    _mixtac_venv=$_mixtac_root/.venv
    export AMENT_PREFIX_PATH=$_mixtac_venv
    export ROS_VERSION=2 ROS_PYTHON_VERSION=3
fi
export VIRTUAL_ENV=$_mixtac_venv PATH=$_mixtac_venv/bin:$PATH
if [ -f "$_mixtac_root/install/setup.bash" ] && [ "$_mixtac_venv" = "$_mixtac_root/.venv-ros" ]; then
    _mixtac_flags=$-
    set +u
    # shellcheck disable=SC1091
    . "$_mixtac_root/install/setup.bash"
    case $_mixtac_flags in *u*) set -u ;; esac
    unset _mixtac_flags
fi
# Nothing is reachable from other machines unless the user asks for it.
export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}
# Fast DDS keeps more for a subscriber that is delayed, and opens no port beyond this machine; a
# profile of the user's own is left in place. Newer versions of Fast DDS read the second name.
case ${FASTRTPS_DEFAULT_PROFILES_FILE:-${FASTDDS_DEFAULT_PROFILES_FILE:-}} in
    '' | "$_mixtac_root"/config/fastdds/*)
        case $ROS_AUTOMATIC_DISCOVERY_RANGE in
            LOCALHOST | OFF) _mixtac_dds=$_mixtac_root/config/fastdds/local.xml ;;
            *) _mixtac_dds=$_mixtac_root/config/fastdds/network.xml ;;
        esac
        export FASTRTPS_DEFAULT_PROFILES_FILE=$_mixtac_dds FASTDDS_DEFAULT_PROFILES_FILE=$_mixtac_dds
        unset _mixtac_dds
        ;;
esac
export RCUTILS_LOGGING_BUFFERED_STREAM=1
# Container images often set it; every node would compile what it imports anew at each start.
unset PYTHONDONTWRITEBYTECODE
unset _mixtac_root _mixtac_venv
