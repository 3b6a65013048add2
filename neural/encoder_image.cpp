#include "generator/core/error.h"
#include "neural/area_average.h"
#include "neural/samples.h"

namespace moomill {

torch::Tensor make_encoder_image(const torch::Tensor& color, const torch::Tensor& mask, const torch::Tensor& nnopcs,
                                 const EncoderInput& encoder) {
  check(color.defined() && color.dim() == 3 && color.size(0) == 3, "a picture for the encoder is [3, h, w]");
  const int h = static_cast<int>(color.size(1)), w = static_cast<int>(color.size(2));
  check(mask.defined() && mask.dim() == 2 && mask.size(0) == h && mask.size(1) == w, "its mask is [h, w]");
  check(!nnopcs.defined() || nnopcs.sizes() == color.sizes(), "its NNOPCS is [3, h, w]");
  const torch::NoGradGuard no_grad;
  const auto plain = [](const torch::Tensor& t) { return t.detach().to(torch::kCPU, torch::kFloat32).contiguous(); };
  const torch::Tensor c = plain(color), m = plain(mask), n = nnopcs.defined() ? plain(nnopcs) : torch::Tensor();
  const float* masks = m.data_ptr<float>();
  const int ew = encoder.width > 0 ? encoder.width : w, eh = encoder.height > 0 ? encoder.height : h;
  Window window = whole_picture(w, h);
  if (encoder.crop) {
    std::vector<double> columns(w), rows(h);
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x) {
        columns[x] += masks[static_cast<std::size_t>(y) * w + x];
        rows[y] += masks[static_cast<std::size_t>(y) * w + x];
      }
    window = mask_window(columns, rows, ew, eh);
  }
  const AreaAverage resize(w, h, ew, eh, window);
  const int channels = n.defined() ? 6 : 3;
  torch::Tensor out = torch::zeros({channels, resize.to_height, resize.to_width});
  const std::size_t plane = static_cast<std::size_t>(w) * h;
  const float *colors = c.data_ptr<float>(), *maps = n.defined() ? n.data_ptr<float>() : nullptr;
  float* planes = out.data_ptr<float>();
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * w + x;
      if (masks[i] == 0) continue;
      float values[6];
      for (int j = 0; j < 3; ++j) values[j] = masks[i] * colors[j * plane + i];
      for (int j = 0; j < 3 && maps; ++j) values[3 + j] = masks[i] * maps[j * plane + i];
      resize.add(x, y, channels, values, planes);
    }
  return out;
}

}  // namespace moomill
