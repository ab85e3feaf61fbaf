# Writes OUTPUT, a C++ file with the text of every schema in FOLDER:
#   cmake -D FOLDER=docs/schemas -D OUTPUT=schema_table.cpp -P embed_schemas.cmake
file(GLOB files ${FOLDER}/*.json)
list(SORT files)
set(table "")
foreach(file IN LISTS files)
  file(READ ${file} text)
  get_filename_component(verb ${file} NAME_WE)
  string(JSON id GET "${text}" "$id")
  string(APPEND table "    {\"${verb}\", \"${id}\", R\"json(${text})json\"},\n")
endforeach()
file(WRITE ${OUTPUT} "#include \"cli/schemas.h\"\n
namespace strandbake {
namespace {
constexpr Schema kSchemas[] = {\n${table}};
}  // namespace
std::span<const Schema> schemas() {
  return kSchemas;
}
}  // namespace strandbake\n")
