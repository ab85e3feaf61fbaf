// The results of a benchmark: rows of words and numbers, printed aligned, as CSV, or taken apart for JSON.
#pragma once

#include <string>
#include <variant>
#include <vector>

namespace strandbake {

struct Column {
  std::string key;   // in CSV and JSON: a word with its unit behind, "median_ms"
  std::string head;  // above the column in the text
  int digits = 3;    // significant ones of a number in the text
};

// Nothing, where a row has no such figure.
using Cell = std::variant<std::monostate, std::string, double>;

struct Table {
  std::vector<Column> columns;
  std::vector<std::vector<Cell>> rows;  // a cell a column

  // Cells by key, the others empty, and so is a figure that is not finite. Throws std::out_of_range for a key that no
  // column has.
  void add(const std::vector<std::pair<std::string, Cell>>& cells);
  std::size_t index_of(const std::string& key) const;
};

// Columns that are empty in every row are left out; numbers are aligned to the right.
std::string text_of(const Table& table);
// RFC 4180 with line feeds: a line of keys, then one a row.
std::string csv_of(const Table& table);

}  // namespace strandbake
