#include "cli/bench/table.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace strandbake {
namespace {

// Significant digits without exponents: 0.0123, 12.3, 12300.
std::string number_text(double value, int digits) {
  if (value == std::floor(value) && std::abs(value) < 1e15) return fmt::format("{:.0f}", value);
  const int before = value == 0 ? 1 : static_cast<int>(std::floor(std::log10(std::abs(value)))) + 1;
  return fmt::format("{:.{}f}", value, std::max(0, digits - before));
}

std::string cell_text(const Cell& cell, int digits) {
  if (const auto* text = std::get_if<std::string>(&cell)) return *text;
  if (const auto* value = std::get_if<double>(&cell)) return number_text(*value, digits);
  return "";
}

std::string quoted(const std::string& text) {
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"') out += '"';
    out += c;
  }
  return out + '"';
}

}  // namespace

std::size_t Table::index_of(const std::string& key) const {
  const auto at = std::ranges::find(columns, key, &Column::key);
  if (at == columns.end()) throw std::out_of_range("no column " + key);
  return static_cast<std::size_t>(at - columns.begin());
}

void Table::add(const std::vector<std::pair<std::string, Cell>>& cells) {
  std::vector<Cell> row(columns.size());
  for (const auto& [key, cell] : cells) {
    const auto* value = std::get_if<double>(&cell);
    row[index_of(key)] = value != nullptr && !std::isfinite(*value) ? Cell() : cell;
  }
  rows.push_back(std::move(row));
}

std::string text_of(const Table& table) {
  std::vector<std::string> lines(table.rows.size() + 1);
  for (std::size_t c = 0; c < table.columns.size(); ++c) {
    const auto empty = [c](const std::vector<Cell>& row) { return std::holds_alternative<std::monostate>(row[c]); };
    const auto words = [c](const std::vector<Cell>& row) { return std::holds_alternative<std::string>(row[c]); };
    if (std::ranges::all_of(table.rows, empty)) continue;
    const bool left = std::ranges::any_of(table.rows, words);
    std::vector<std::string> cells = {table.columns[c].head};
    for (const auto& row : table.rows) cells.push_back(cell_text(row[c], table.columns[c].digits));
    std::size_t width = 0;
    for (const std::string& cell : cells) width = std::max(width, cell.size());
    for (std::size_t r = 0; r < cells.size(); ++r) {
      if (!lines[r].empty()) lines[r] += "  ";
      lines[r] += left ? fmt::format("{:<{}}", cells[r], width) : fmt::format("{:>{}}", cells[r], width);
    }
  }
  std::string text;
  for (std::string& line : lines) {
    line.erase(line.find_last_not_of(' ') + 1);
    text += line + '\n';
  }
  return text;
}

std::string csv_of(const Table& table) {
  std::string text;
  for (std::size_t c = 0; c < table.columns.size(); ++c) text += (c == 0 ? "" : ",") + table.columns[c].key;
  text += '\n';
  for (const auto& row : table.rows) {
    for (std::size_t c = 0; c < row.size(); ++c) {
      if (c > 0) text += ',';
      if (const auto* words = std::get_if<std::string>(&row[c])) text += quoted(*words);
      if (const auto* value = std::get_if<double>(&row[c])) text += fmt::format("{:.6g}", *value);
    }
    text += '\n';
  }
  return text;
}

}  // namespace strandbake
