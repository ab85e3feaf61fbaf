// The page that `strandbake view` writes, without a shot in it: view/page.html.
#pragma once

#include <string_view>

namespace strandbake {

// With @SHOT@ and @POSITIONS@ in the places of JSON and of base64.
extern const std::string_view view_page;

}  // namespace strandbake
