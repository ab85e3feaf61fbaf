# Flags for our own targets only: strandbake_options carries them, and every target of ours links it privately.
add_library(strandbake_options INTERFACE)
target_compile_options(strandbake_options INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wno-sign-conversion -Werror
  # One rounding per operation on every machine: the promise of equal bytes rests on it.
  -ffp-contract=off
  # Neither changes a result; without them a vector square root becomes a loop of calls.
  -fno-math-errno -fno-trapping-math)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # GCC 12's SLP vectoriser drops the rounding of a double to float and back, and fuses in spite of -ffp-contract=off.
  target_compile_options(strandbake_options INTERFACE -fno-tree-slp-vectorize)
  if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
    target_compile_options(strandbake_options INTERFACE -mno-fma)
  endif()
  # It sees these two where there is nothing: in std::string (its bug 105651) and in Eigen, at -O3.
  target_compile_options(strandbake_options INTERFACE -Wno-restrict -Wno-maybe-uninitialized)
endif()
# A library that a binary does not call is not loaded by it.
target_link_options(strandbake_options INTERFACE -Wl,--as-needed)
target_include_directories(strandbake_options INTERFACE ${PROJECT_SOURCE_DIR})
if(STRANDBAKE_SANITIZE)
  target_compile_options(strandbake_options INTERFACE -fsanitize=${STRANDBAKE_SANITIZE} -fno-omit-frame-pointer
    -fno-sanitize-recover=all)
  target_link_options(strandbake_options INTERFACE -fsanitize=${STRANDBAKE_SANITIZE})
endif()
if(STRANDBAKE_FUZZ)
  target_compile_options(strandbake_options INTERFACE -fsanitize=fuzzer-no-link)
endif()
if(STRANDBAKE_COVERAGE)
  target_compile_options(strandbake_options INTERFACE $<$<NOT:$<BOOL:$<TARGET_PROPERTY:STRANDBAKE_UNCOUNTED>>>:--coverage>)
  target_link_options(strandbake_options INTERFACE --coverage)
endif()
