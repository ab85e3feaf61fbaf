# What `cmake --install` and `cpack` take along beside the targets. Components: program, library, python; Debian makes a package
# of each, a tarball has them all.
include(CMakePackageConfigHelpers)

set(config_folder ${CMAKE_INSTALL_LIBDIR}/cmake/strandbake)
configure_package_config_file(cmake/strandbakeConfig.cmake.in ${PROJECT_BINARY_DIR}/strandbakeConfig.cmake
  INSTALL_DESTINATION ${config_folder} NO_SET_AND_CHECK_MACRO)
write_basic_package_version_file(${PROJECT_BINARY_DIR}/strandbakeConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/strandbakeConfig.cmake ${PROJECT_BINARY_DIR}/strandbakeConfigVersion.cmake
  DESTINATION ${config_folder} COMPONENT library)
install(EXPORT strandbake NAMESPACE strandbake:: FILE strandbakeTargets.cmake DESTINATION ${config_folder} COMPONENT library)

# Links between the documents stay right.
install(FILES README.md CHANGELOG.md DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT program)
# Where Debian wants each package to have it.
install(FILES LICENSE RENAME copyright DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT program)
install(FILES LICENSE RENAME copyright DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/libstrandbake-dev COMPONENT library)
install(FILES LICENSE RENAME copyright DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/python3-strandcache COMPONENT python)
install(DIRECTORY docs DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT program)
install(DIRECTORY scenes DESTINATION ${CMAKE_INSTALL_DATADIR}/strandbake COMPONENT program PATTERN golden EXCLUDE)
# Debian's Python looks here below /usr; elsewhere PYTHONPATH names it.
install(DIRECTORY formats/python/strandcache DESTINATION lib/python3/dist-packages COMPONENT python PATTERN __pycache__ EXCLUDE)

set(CPACK_GENERATOR TGZ)
find_program(DPKG_SHLIBDEPS dpkg-shlibdeps)
if(DPKG_SHLIBDEPS)
  list(APPEND CPACK_GENERATOR DEB)
endif()
set(CPACK_PACKAGE_VENDOR "The Strandbake authors")
set(CPACK_PACKAGE_CONTACT "The Strandbake authors")
set(CPACK_PACKAGE_DIRECTORY ${PROJECT_BINARY_DIR}/packages)
set(CPACK_SYSTEM_NAME linux-${CMAKE_SYSTEM_PROCESSOR})
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
  OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_COMPONENTS_ALL program library python)
set(CPACK_THREADS 0)

set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION graphics)
set(CPACK_DEBIAN_PROGRAM_PACKAGE_NAME strandbake)
set(CPACK_COMPONENT_PROGRAM_DESCRIPTION
  "A groom of hair polylines and an animated head go in, one HDF5 cache with every\nvertex of every frame comes out.")
set(CPACK_DEBIAN_PROGRAM_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PROGRAM_PACKAGE_SUGGESTS "ffmpeg, ocl-icd-libopencl1, python3-strandcache")
set(CPACK_DEBIAN_LIBRARY_PACKAGE_NAME libstrandbake-dev)
set(CPACK_DEBIAN_LIBRARY_PACKAGE_SECTION libdevel)
set(CPACK_COMPONENT_LIBRARY_DESCRIPTION
  "The solver for other C++ programs: headers, a static library and a package for\nCMake.")
set(CPACK_DEBIAN_LIBRARY_PACKAGE_DEPENDS "libeigen3-dev (>= 3.4), libgomp1")
set(CPACK_DEBIAN_PYTHON_PACKAGE_NAME python3-strandcache)
set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
set(CPACK_DEBIAN_PYTHON_PACKAGE_ARCHITECTURE all)
set(CPACK_COMPONENT_PYTHON_DESCRIPTION
  "Its caches in Python: positions as numpy arrays, conversion to USD and Alembic,\nan add-on for Blender.")
set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "python3 (>= 3.10), python3-h5py, python3-numpy")
include(CPack)
