# Writes OUTPUT, a header that names the commit of SOURCE, and touches it only where that has changed. Run at build time:
#   cmake -D SOURCE=folder -D OUTPUT=header -P commit.cmake
# Without git, or outside a checkout, the commit is "unknown". A checkout with changes says so.
set(commit "unknown")
find_program(git git)
if(git)
  execute_process(COMMAND ${git} -C ${SOURCE} describe --always --abbrev=12 --exclude=* --dirty
    OUTPUT_VARIABLE found OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
  if(NOT failed AND EXISTS ${SOURCE}/.git)
    set(commit ${found})
  endif()
endif()
set(text "#pragma once\n#define STRANDBAKE_COMMIT \"${commit}\"\n")
if(EXISTS ${OUTPUT})
  file(READ ${OUTPUT} old)
endif()
if(NOT text STREQUAL "${old}")
  file(WRITE ${OUTPUT} ${text})
endif()
