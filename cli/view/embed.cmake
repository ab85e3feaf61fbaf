# Puts the page into the program, as a C++ array: cmake -D PAGE=... -D OUTPUT=... -P
file(READ "${PAGE}" bytes HEX)
string(REGEX REPLACE "(..)" "0x\\1," bytes "${bytes}")
file(WRITE "${OUTPUT}" "#include \"cli/view/page.h\"\n\nnamespace strandbake {\nnamespace {\nconst unsigned char kBytes[] = {${bytes}};\n}\n"
  "const std::string_view view_page(reinterpret_cast<const char*>(kBytes), sizeof kBytes);\n}  // namespace strandbake\n")
