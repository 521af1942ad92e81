# soopnav_set_warnings(TARGET): the warnings every target of this project is built with.
# They are private to the target: whoever links soopnav keeps their own.
add_library(soopnav_build_flags INTERFACE)
if(PROJECT_IS_TOP_LEVEL)
  target_compile_options(soopnav_build_flags INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wconversion
    -Wsign-conversion -Wdouble-promotion -Wnon-virtual-dtor -Wold-style-cast -Woverloaded-virtual)
  if(SOOPNAV_WARNINGS_AS_ERRORS)
    target_compile_options(soopnav_build_flags INTERFACE -Werror)
  endif()
  if(SOOPNAV_SANITIZE)
    target_compile_options(soopnav_build_flags INTERFACE -fsanitize=${SOOPNAV_SANITIZE} -fno-omit-frame-pointer
      -fno-sanitize-recover=all)
    target_link_options(soopnav_build_flags INTERFACE -fsanitize=${SOOPNAV_SANITIZE})
    # Resolvers of multi-versioned functions run before a sanitizer's runtime is up.
    target_compile_definitions(soopnav_build_flags INTERFACE SOOPNAV_NO_TARGET_CLONES)
  endif()
  if(SOOPNAV_BUILD_FUZZ)
    target_compile_options(soopnav_build_flags INTERFACE -fsanitize=fuzzer-no-link)
  endif()
endif()
# The widest vectors chosen at run time must not change a result: no contraction to fused multiply-adds.
target_compile_options(soopnav_build_flags INTERFACE -ffp-contract=off)

function(soopnav_set_warnings target)
  target_link_libraries(${target} PRIVATE $<BUILD_INTERFACE:soopnav_build_flags>)
endfunction()
