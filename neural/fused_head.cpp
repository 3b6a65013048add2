// The residual perceptron of a head as an autograd function over kernels/head.h.
#include "neural/kernels/head.h"
#include "neural/operator_tools.h"

namespace moomill {

namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

enum HeadInput {
  features,
  in_weight,
  in_bias,
  feature_weight,
  feature_bias,
  first_weight,
  first_bias,
  second_weight,
  second_bias,
  out_weight,
  out_bias,
  head_inputs
};

// Arguments of the kernels, and the memory they point to.
template <class T>
struct PackedHead {
  HeadArguments<T> arguments;
  std::vector<Tensor> owned;

  const T* keep(const Tensor& tensor) {
    owned.push_back(tensor);
    return data<T>(tensor);
  }

  PackedHead(const variable_list& in, bool backward, bool bfloat16) {
    HeadArguments<T>& a = arguments;
    a.features = int(in[features].size(1));
    a.width = int(in[in_weight].size(0));
    a.blocks = int(in[first_weight].size(0));
    a.outputs = int(in[out_weight].size(0));
    Tensor start = in[in_weight], start_bias = in[in_bias];
    if (a.blocks > 0) start = start + in[feature_weight][0], start_bias = start_bias + in[feature_bias][0];
    a.in_t = keep(pack(start.t(), bfloat16));
    a.in_bias = keep(start_bias);
    a.feature_t = keep(pack(in[feature_weight].transpose(1, 2), bfloat16));
    a.feature_bias = keep(in[feature_bias]);
    a.first_t = keep(pack(in[first_weight].transpose(1, 2), bfloat16));
    a.first_bias = keep(in[first_bias]);
    a.second_t = keep(pack(in[second_weight].transpose(1, 2), bfloat16));
    a.second_bias = keep(in[second_bias]);
    a.out_t = keep(at::constant_pad_nd(in[out_weight].t(), {0, head_outputs - a.outputs}).contiguous());
    a.out_bias = keep(at::constant_pad_nd(in[out_bias], {0, head_outputs - a.outputs}).contiguous());
    if (!backward) return;
    a.in = keep(pack(start, bfloat16));
    a.feature = keep(pack(in[feature_weight], bfloat16));
    a.first = keep(pack(in[first_weight], bfloat16));
    a.second = keep(pack(in[second_weight], bfloat16));
    a.out = keep(in[out_weight]);
  }
};

template <class T>
Tensor head_forward(const variable_list& in, bool bfloat16, bool keep, Tensor& kept) {
  const auto& kernels = head_kernels<T>(bfloat16);
  const PackedHead<T> head(in, false, bfloat16);
  const auto& a = head.arguments;
  const std::int64_t rows = in[features].size(0), chunk = 4 * kernels.tile_rows(a);
  Tensor out = at::empty({rows, a.outputs}, in[features].options());
  const std::int64_t step = kernels.tile_rows(a), tile_bytes = std::int64_t(kernels.kept_bytes(a));
  std::int64_t kept_tiles = 0;
  if (keep && a.width >= least_kept_channels)
    kept_tiles = std::min((rows + step - 1) / step, most_kept_bytes.load() / 2 / tile_bytes);
  kept = memory_for_keeping(kept_tiles * tile_bytes);
  for_each((rows + chunk - 1) / chunk, kernels.workspace(a, false), [&](std::int64_t i, void* scratch) {
    kernels.forward(a, data<T>(in[features]), i * chunk, std::min((i + 1) * chunk, rows), out.data_ptr<T>(),
                    kept.data_ptr(), kept_tiles * step, scratch);
  });
  return out;
}

template <class T>
variable_list head_backward(const variable_list& in, const Tensor& kept, const Tensor& out_gradient, bool bfloat16) {
  const auto& kernels = head_kernels<T>(bfloat16);
  const PackedHead<T> head(in, true, bfloat16);
  const auto& a = head.arguments;
  const std::int64_t rows = in[features].size(0), step = kernels.tile_rows(a), tiles = (rows + step - 1) / step;
  const std::int64_t parts = std::min(tiles, most_parts);

  bool of_weights = false;
  std::int64_t offset[head_inputs + 1] =
      {};  // of each weight's gradient in a part's buffer; multiples of 16 but the last
  for (int input = in_weight; input < head_inputs; ++input) {
    of_weights = of_weights || in[input].requires_grad();
    offset[input + 1] = offset[input] + in[input].numel();
  }
  offset[head_inputs] = (offset[head_inputs] + 15) / 16 * 16;
  const auto options = in[features].options().requires_grad(false);
  Tensor sums, features_gradient;
  if (of_weights) sums = at::zeros({std::max<std::int64_t>(parts, 1), offset[head_inputs]}, options);
  if (in[features].requires_grad()) features_gradient = at::empty(in[features].sizes(), options);
  for_each(parts, kernels.workspace(a, true), [&](std::int64_t part, void* scratch) {
    HeadGradients<T> g;
    g.features = data<T>(features_gradient);
    if (of_weights) {
      auto place = [&](int input) { return data<T>(sums) + part * offset[head_inputs] + offset[input]; };
      g.in = place(in_weight);
      g.in_bias = place(in_bias);
      g.feature = place(feature_weight);
      g.feature_bias = place(feature_bias);
      g.first = place(first_weight);
      g.first_bias = place(first_bias);
      g.second = place(second_weight);
      g.second_bias = place(second_bias);
      g.out = place(out_weight);
      g.out_bias = place(out_bias);
    }
    kernels.backward(a, data<T>(in[features]), part * tiles / parts * step,
                     std::min((part + 1) * tiles / parts * step, rows), data<T>(out_gradient), kept.data_ptr(),
                     kept.numel() / std::int64_t(kernels.kept_bytes(a)) * step, g, scratch);
  });
  variable_list gradients(head_inputs);
  gradients[features] = features_gradient;
  if (!of_weights) return gradients;
  const Tensor sum = sum_in_order(sums);
  for (int input = in_weight; input < head_inputs; ++input)
    if (in[input].requires_grad())
      gradients[input] = sum.narrow(0, offset[input], in[input].numel()).view(in[input].sizes()).clone();
  if (a.blocks > 0) {  // the first feature layer sees what the input layer sees
    auto of_input = [&](int input) { return sum.narrow(0, offset[input], in[input].numel()).view(in[input].sizes()); };
    if (gradients[feature_weight].defined()) gradients[feature_weight][0].copy_(of_input(in_weight));
    if (gradients[feature_bias].defined()) gradients[feature_bias][0].copy_(of_input(in_bias));
  }
  return gradients;
}

struct HeadFunction : torch::autograd::Function<HeadFunction> {
  static Tensor forward(AutogradContext* context, bool bfloat16, bool keep, Tensor features, Tensor in_weight,
                        Tensor in_bias, Tensor feature_weight, Tensor feature_bias, Tensor first_weight,
                        Tensor first_bias, Tensor second_weight, Tensor second_bias, Tensor out_weight,
                        Tensor out_bias) {
    variable_list in{features,   in_weight,     in_bias,     feature_weight, feature_bias, first_weight,
                     first_bias, second_weight, second_bias, out_weight,     out_bias};
    context->saved_data["bfloat16"] = bfloat16;
    Tensor kept;
    const Tensor out = features.scalar_type() == at::kFloat ? head_forward<float>(in, bfloat16, keep, kept)
                                                            : head_forward<double>(in, false, keep, kept);
    in.push_back(kept);
    context->save_for_backward(in);
    return out;
  }
  static variable_list backward(AutogradContext* context, variable_list out_gradients) {
    variable_list in = context->get_saved_variables();
    const Tensor kept = in.back();
    in.pop_back();
    const Tensor gradient = out_gradients[0].contiguous();
    variable_list gradients = gradient.scalar_type() == at::kFloat
                                  ? head_backward<float>(in, kept, gradient, context->saved_data["bfloat16"].toBool())
                                  : head_backward<double>(in, kept, gradient, false);
    gradients.insert(gradients.begin(), 2, Tensor());  // of the flags
    return gradients;
  }
};

}  // namespace

Tensor fused_head(const Tensor& features, const HeadWeights& weights, Precision precision) {
  check(features.defined() && features.dim() == 2 && weights.in_weight.defined() && weights.in_weight.dim() == 2 &&
            weights.first_weight.defined() && weights.first_weight.dim() == 3 && weights.out_weight.defined() &&
            weights.out_weight.dim() == 2,
        "fused_head: features and weights have two dimensions, those of blocks three");
  const auto type = features.scalar_type();
  const std::int64_t d = features.size(1), h = weights.in_weight.size(0), n = weights.first_weight.size(0);
  const std::int64_t outputs = weights.out_weight.size(0);
  check(type == at::kFloat || type == at::kDouble, "fused_head: float or double");
  check(type == at::kDouble || (d % 16 == 0 && h % 16 == 0), "fused_head: widths are multiples of 16");
  check(d >= 1 && h >= 1 && outputs >= 1 && outputs <= head_outputs, "fused_head: 1 to 16 outputs");
  check_precision(precision, type);
  check_tensor(features, {features.size(0), d}, type, "fused_head: features");
  check_tensor(weights.in_weight, {h, d}, type, "fused_head: in_weight");
  check_tensor(weights.in_bias, {h}, type, "fused_head: in_bias");
  check_tensor(weights.feature_weight, {n, h, d}, type, "fused_head: feature_weight");
  check_tensor(weights.feature_bias, {n, h}, type, "fused_head: feature_bias");
  check_tensor(weights.first_weight, {n, h, h}, type, "fused_head: first_weight");
  check_tensor(weights.first_bias, {n, h}, type, "fused_head: first_bias");
  check_tensor(weights.second_weight, {n, h, h}, type, "fused_head: second_weight");
  check_tensor(weights.second_bias, {n, h}, type, "fused_head: second_bias");
  check_tensor(weights.out_weight, {outputs, h}, type, "fused_head: out_weight");
  check_tensor(weights.out_bias, {outputs}, type, "fused_head: out_bias");
  const std::int64_t more_d = (16 - d % 16) % 16, more_h = (16 - h % 16) % 16;  // only for double
  auto padded = [](const Tensor& tensor, std::int64_t columns, std::int64_t rows) {
    if (columns == 0 && rows == 0) return tensor.contiguous();
    return (tensor.dim() == 1 || rows == 0 ? at::constant_pad_nd(tensor, {0, columns})
                                           : at::constant_pad_nd(tensor, {0, columns, 0, rows}))
        .contiguous();
  };
  const variable_list inputs{features,
                             weights.in_weight,
                             weights.in_bias,
                             weights.feature_weight,
                             weights.feature_bias,
                             weights.first_weight,
                             weights.first_bias,
                             weights.second_weight,
                             weights.second_bias,
                             weights.out_weight,
                             weights.out_bias};
  return HeadFunction::apply(precision == Precision::bfloat16, will_differentiate(inputs), padded(features, more_d, 0),
                             padded(weights.in_weight, more_d, more_h), padded(weights.in_bias, more_h, 0),
                             padded(weights.feature_weight, more_d, more_h), padded(weights.feature_bias, more_h, 0),
                             padded(weights.first_weight, more_h, more_h), padded(weights.first_bias, more_h, 0),
                             padded(weights.second_weight, more_h, more_h), padded(weights.second_bias, more_h, 0),
                             padded(weights.out_weight, more_h, 0), weights.out_bias.contiguous());
}

}  // namespace moomill
