#pragma once
// Line charts as SVG.
#include <filesystem>
#include <string>
#include <vector>

namespace moomill {

struct Curve {
  std::string name;
  std::vector<double> x, y;  // what is not finite is left out
  bool dashed = false;       // a guide rather than a measurement
};

// Several panels below each other, all over the same quantity; a panel's y axis is logarithmic where all its values are positive,
// and so is x where it is asked for.
struct Panel {
  std::string title;  // with unit
  std::vector<Curve> curves;
  double bar = 0;     // a dashed line to hold the curves against; 0: none
  std::string bar_name;
};
std::string draw_curves(const std::string& title, const std::string& x_title, const std::vector<Panel>& panels,
                        bool logarithmic_x = false);

}  // namespace moomill
