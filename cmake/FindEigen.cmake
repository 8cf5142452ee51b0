# SPDX-License-Identifier: GPL-3.0-or-later
# Eigen from PyPI's cmeel-eigen where the build's Python has it, otherwise from the system.
if(NOT TARGET Eigen3::Eigen)
  if(Python_EXECUTABLE)
    execute_process(
      COMMAND "${Python_EXECUTABLE}" -c
        "import importlib.metadata as m; print(m.distribution('cmeel-eigen').locate_file('cmeel.prefix'))"
      OUTPUT_VARIABLE cmeel_prefix OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE cmeel_result)
    if(cmeel_result EQUAL 0)
      list(APPEND CMAKE_PREFIX_PATH "${cmeel_prefix}")
    endif()
  endif()
  # Eigen's own version file refuses 5.x to whoever asks for 3.4, though it is fine here.
  find_package(Eigen3 REQUIRED NO_MODULE)
  if(Eigen3_VERSION VERSION_LESS 3.4)
    message(FATAL_ERROR "Eigen: found ${Eigen3_VERSION}, expected 3.4 or newer (pip install cmeel-eigen)")
  endif()
endif()
