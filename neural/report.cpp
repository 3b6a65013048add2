#include "neural/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"

namespace moomill {

using torch::Tensor;

bool Measure::holds() const {
  if (!std::isfinite(value)) return !at_most && !at_least;
  return (!at_most || value <= *at_most) && (!at_least || value >= *at_least);
}

nlohmann::json number_json(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json();
}

std::string summary_json(const std::string& title, const std::vector<Measure>& measures) {
  nlohmann::json figures = nlohmann::json::array();
  for (const Measure& m : measures) {
    nlohmann::json j{{"name", m.name}, {"unit", m.unit}, {"value", number_json(m.value)}, {"holds", m.holds()}};
    if (m.at_most) j["at_most"] = *m.at_most;
    if (m.at_least) j["at_least"] = *m.at_least;
    figures.push_back(std::move(j));
  }
  return nlohmann::json{{"title", title}, {"figures", figures}}.dump(2) + "\n";
}

std::string figure_text(double value, int decimals) {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, decimals) : "-";
}

Image8 picture_of(const Tensor& image) {
  const Tensor rgb = image.dim() == 2 ? image.unsqueeze(0).expand({3, image.size(0), image.size(1)}) : image;
  const Tensor bytes = (rgb.clamp(0, 1) * 255 + 0.5).floor().to(torch::kUInt8).permute({1, 2, 0}).contiguous();
  Image8 out(static_cast<int>(bytes.size(1)), static_cast<int>(bytes.size(0)), 3);
  std::copy_n(bytes.data_ptr<std::uint8_t>(), out.data.size(), out.data.data());
  return out;
}

Image8 nnopcs_picture(const Tensor& nnopcs, const Tensor& mask) {
  return picture_of(torch::where(mask.unsqueeze(0) > 0.5, nnopcs.clamp_min(1.0 / 255), torch::zeros_like(nnopcs)));
}

Tensor tensor_of(const Image8& image) {
  const Tensor bytes = torch::from_blob(const_cast<std::uint8_t*>(image.data.data()),
                                        {image.height, image.width, image.channels}, torch::kUInt8);
  return (bytes.to(torch::kFloat) / 255)
      .permute({2, 0, 1})
      .slice(0, 0, image.channels == 4 ? 3 : image.channels)
      .contiguous();
}

Image8 crop(const Image8& image, const PixelBox& box) {
  Image8 out(box.width(), box.height(), image.channels);
  for (int y = 0; y < out.height; ++y)
    std::copy_n(&image.data[image.index(box.x0, box.y0 + y)], static_cast<std::size_t>(out.width) * out.channels,
                &out.data[out.index(0, y)]);
  return out;
}

void write_png(const std::filesystem::path& file, const Image8& image) {
  const std::vector<std::uint8_t> bytes = encode_png8(image);
  write_file_atomically(file, bytes.data(), bytes.size());
}

}  // namespace moomill
