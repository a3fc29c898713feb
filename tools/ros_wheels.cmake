# Makes `colcon build` work against the ROS 2 wheels of the Python environment. colcon.meta has
# CMake include this file right after project() of each message package.
#
# Where ROS 2 itself is installed and sourced it does nothing: there, the environment's prefix
# holds no ROS packages (its ament index does not list rclpy), because the set-up installs the
# wheels only where no ROS_DISTRO is set; and without an active environment there is no prefix.
if(NOT EXISTS "$ENV{VIRTUAL_ENV}/share/ament_index/resource_index/packages/rclpy")
  return()
endif()

# 1. The generators ask the ament index for each other, so it must know where the wheels are.
set(ENV{AMENT_PREFIX_PATH} "$ENV{VIRTUAL_ENV}:$ENV{AMENT_PREFIX_PATH}")

# 2. The targets that the wheels export name include folders of the machine they were built on
# (/opt/python/cp3xx-...), and CMake refuses folders that do not exist. The generators use the
# headers of the Python they run on anyway. Deferred, since the targets are imported later.
function(_ros_wheels_drop_foreign_include_folders)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(folders MATCHES "/opt/python/")
      list(FILTER folders EXCLUDE REGEX "^/opt/python/")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${folders}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL _ros_wheels_drop_foreign_include_folders)
