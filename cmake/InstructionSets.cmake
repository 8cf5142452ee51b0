# SPDX-License-Identifier: GPL-3.0-or-later
# Kernel files (*.kernel.cpp) are compiled once per instruction set, each into a namespace of its own (FOLLOWTHROUGH_ISA), and picked
# at run time. They must include no header with inline functions of a library (Eigen, most of the standard library): the linker keeps
# one copy of such a function, and it may be the AVX-512 one.
# Files *.amx.cpp are such kernels for one set alone.
include(CheckCXXCompilerFlag)
file(GLOB_RECURSE kernel_sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/cpp/src/*.kernel.cpp")

file(GLOB_RECURSE amx_sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/cpp/src/*.amx.cpp")

function(followthrough_add_kernels isa)
  if(isa STREQUAL "amx")
    set(kernel_sources ${amx_sources})
  endif()
  add_library(followthrough_kernels_${isa} OBJECT ${kernel_sources})
  target_include_directories(followthrough_kernels_${isa} PRIVATE cpp/include cpp/src)
  target_compile_definitions(followthrough_kernels_${isa} PRIVATE FOLLOWTHROUGH_ISA=${isa})
  target_compile_options(followthrough_kernels_${isa} PRIVATE ${ARGN})
  if(NOT MSVC)
    # One way of rounding on every instruction set: no contraction to fused multiply-adds behind our back.
    target_compile_options(followthrough_kernels_${isa} PRIVATE -O3 -fno-math-errno -fno-trapping-math -ffp-contract=off)
  endif()
  target_sources(followthrough_core PRIVATE $<TARGET_OBJECTS:followthrough_kernels_${isa}>)
  target_compile_definitions(followthrough_core PUBLIC FOLLOWTHROUGH_HAS_${isa})
endfunction()

if(kernel_sources)
  if(CMAKE_SYSTEM_PROCESSOR MATCHES "^(x86_64|AMD64|amd64)$" AND NOT CMAKE_OSX_ARCHITECTURES MATCHES "arm64")
    if(MSVC)
      followthrough_add_kernels(baseline)
      followthrough_add_kernels(avx2 /arch:AVX2)
      followthrough_add_kernels(avx512 /arch:AVX512)
    else()
      followthrough_add_kernels(baseline -march=x86-64-v2)
      followthrough_add_kernels(avx2 -march=x86-64-v3)
      followthrough_add_kernels(avx512 -march=x86-64-v4 -mprefer-vector-width=512)
      set(amx_flags -mavx512bf16 -mamx-tile -mamx-bf16)
      check_cxx_compiler_flag("${amx_flags}" FOLLOWTHROUGH_COMPILES_AMX)
      if(CMAKE_SYSTEM_NAME STREQUAL "Linux" AND FOLLOWTHROUGH_COMPILES_AMX)
        followthrough_add_kernels(amx -march=x86-64-v4 -mprefer-vector-width=512 ${amx_flags})
      endif()
    endif()
  else()
    followthrough_add_kernels(baseline)
  endif()
endif()
