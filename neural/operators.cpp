#include "neural/operators.h"

#include <ATen/Parallel.h>
#include <omp.h>

#include <algorithm>
#include <cmath>

#include "generator/core/error.h"
#include "neural/kernels/attention.h"
#include "neural/kernels/cpu.h"
#include "neural/kernels/head.h"

namespace moomill {

namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

// Gradients of weights are summed in at most so many parts, each a fixed share of the work whatever the number of
// threads.
constexpr std::int64_t most_parts = 16;

// What the forward pass keeps for the backward pass beside its inputs, where computing it anew costs more than writing
// and reading it: at most so many bytes a call; the rest is computed anew.
constexpr std::size_t most_kept_bytes = std::size_t{1} << 30;
constexpr std::int64_t least_kept_channels = 64;

// Calls work(index, scratch) for every index below count; scratch is the thread's own.
template <class Work>
void for_each(std::int64_t count, std::size_t scratch_bytes, Work work) {
  if (count == 0) return;
  const int threads = int(std::min<std::int64_t>(at::get_num_threads(), count));
  const std::size_t stride = (scratch_bytes + 127) / 64 * 64;  // a cache line apart
  const Tensor scratch = at::empty({std::int64_t(stride) * threads + 64}, at::kByte);
  auto* start = static_cast<char*>(scratch.data_ptr());
  start += (64 - reinterpret_cast<std::uintptr_t>(start) % 64) % 64;
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
  for (std::int64_t i = 0; i < count; ++i) work(i, start + stride * omp_get_thread_num());
}

// Sum over dimension 0, in order: at::sum's order may depend on the number of threads.
Tensor sum_in_order(const Tensor& parts) {
  Tensor sum = parts[0];
  for (std::int64_t i = 1; i < parts.size(0); ++i) sum = i == 1 ? sum + parts[i] : sum.add_(parts[i]);
  return sum;
}

// 64-byte aligned, as the kernels want it.
Tensor memory_for_keeping(std::int64_t bytes) {
  return at::empty({bytes}, at::kByte);
}

// [.., rows, columns] with rows padded_row(columns) apart.
Tensor spread_rows(const Tensor& matrix) {
  auto sizes = matrix.sizes().vec();
  const std::int64_t columns = sizes.back();
  sizes.back() = padded_row(int(columns));
  Tensor spread = at::empty(sizes, matrix.options());
  spread.narrow(-1, 0, columns).copy_(matrix);
  return spread;
}

// [.., k, n] in bfloat16, consecutive pairs along k side by side in the place of a float: [.., k / 2, n], rows spread.
// An odd last row is paired with zeros.
Tensor pack_pairs(const Tensor& matrix) {
  const Tensor even =
      at::constant_pad_nd(matrix.detach(), {0, 0, 0, matrix.size(-2) % 2}).to(at::kBFloat16).contiguous();
  auto sizes = even.sizes().vec();
  sizes.insert(sizes.end() - 1, 2);
  sizes[sizes.size() - 3] /= 2;
  return spread_rows(even.view(sizes).transpose(-1, -2).contiguous().view(at::kFloat).squeeze(-1));
}

Tensor pack(const Tensor& matrix, bool bfloat16) {
  return bfloat16 ? pack_pairs(matrix) : spread_rows(matrix);
}

template <class T>
T* data(const Tensor& tensor) {
  return tensor.defined() ? tensor.data_ptr<T>() : nullptr;
}

void check_tensor(const Tensor& tensor, at::IntArrayRef sizes, at::ScalarType type, const char* what) {
  check(tensor.defined() && tensor.device().is_cpu() && tensor.scalar_type() == type && tensor.sizes() == sizes, what);
}

Tensor pad_channels(const Tensor& tensor, std::int64_t more, bool rows_too = false) {
  if (more == 0) return tensor;
  return rows_too ? at::constant_pad_nd(tensor, {0, more, 0, more}) : at::constant_pad_nd(tensor, {0, more});
}

void check_precision(Precision precision, at::ScalarType type) {
  if (precision == Precision::float32) return;
  if (!has_bfloat16()) input_error("precision bfloat16: this processor has no AVX512-BF16; use float32.");
  check(type == at::kFloat, "bfloat16 products of float tensors only");
}

bool will_differentiate(const variable_list& inputs) {
  if (!at::GradMode::is_enabled()) return false;
  return std::any_of(inputs.begin(), inputs.end(), [](const Tensor& t) { return t.defined() && t.requires_grad(); });
}

// ---- attention ----

enum AttentionInput {
  query,
  key,
  value,
  logit_code,
  value_code,
  mix,
  query_position,
  key_position,
  neighbours,
  extra_key,
  extra_value,
  attention_inputs
};

// Arguments of the kernels that are the same for all frames, and the memory they point to.
template <class T>
struct PackedAttention {
  AttentionArguments<T> arguments;
  std::vector<Tensor> owned;

  const T* keep(const Tensor& tensor) {
    owned.push_back(tensor);
    return data<T>(tensor);
  }

  PackedAttention(const variable_list& in, bool backward, bool bfloat16) {
    AttentionArguments<T>& a = arguments;
    a.channels = int(in[key].size(2));
    a.components = int(in[key_position].size(2));
    a.keys = int(in[key].size(1));
    a.neighbours = in[neighbours].defined() ? int(in[neighbours].size(2)) : a.keys;
    a.has_extra = in[extra_key].defined();
    a.shared_query = in[query].size(1) == 1 && in[query_position].size(1) != 1;
    a.logit_code = keep(pack(in[logit_code], bfloat16));
    a.value_code = keep(pack(in[value_code], bfloat16));
    a.mix_transposed = keep(pack(in[mix].t(), bfloat16));
    if (!backward) return;
    a.mix = keep(pack(in[mix], bfloat16));
    if (!in[query_position].requires_grad() && !in[key_position].requires_grad()) return;
    auto transposed = [&](const Tensor& code) {
      return at::constant_pad_nd(code.detach().t(), {0, code_columns(a.components) - code.size(0)});
    };
    a.logit_code_transposed = keep(pack(transposed(in[logit_code]), bfloat16));
    a.value_code_transposed = keep(pack(transposed(in[value_code]), bfloat16));
  }
};

// The arguments of one frame.
template <class T>
AttentionArguments<T> of_frame(AttentionArguments<T> a, const variable_list& in, std::int64_t frame) {
  auto at = [&](int input) { return data<T>(in[input]) + frame * in[input].stride(0); };
  a.query = at(query);
  a.key = at(key);
  a.value = at(value);
  a.query_position = at(query_position);
  a.key_position = at(key_position);
  if (in[neighbours].defined()) a.neighbour = data<std::int32_t>(in[neighbours]) + frame * in[neighbours].stride(0);
  if (a.has_extra) a.extra_key = at(extra_key), a.extra_value = at(extra_value);
  return a;
}

void* kept_of_frame(const Tensor& kept, std::int64_t frame, std::int64_t frame_bytes) {
  return (frame + 1) * frame_bytes <= kept.numel() ? kept.data_ptr<std::uint8_t>() + frame * frame_bytes : nullptr;
}

template <class T>
Tensor attention_forward(const variable_list& in, bool bfloat16, bool keep, Tensor& kept) {
  const auto& kernels = attention_kernels<T>(bfloat16);
  const PackedAttention<T> packed(in, false, bfloat16);
  const auto& a = packed.arguments;
  const std::int64_t frames = in[key].size(0), queries = in[query_position].size(1);
  Tensor out = at::empty({frames, queries, a.channels}, in[key].options());
  // [kept frames, M, keys of a query, d], as bytes
  const std::int64_t frame_bytes =
      queries * (a.neighbours + a.has_extra) * a.channels * std::int64_t(kernels.kept_size);
  std::int64_t kept_frames = 0;
  if (keep && a.channels >= least_kept_channels && frame_bytes > 0)
    kept_frames = std::min(frames, std::int64_t(most_kept_bytes) / frame_bytes);
  kept = memory_for_keeping(kept_frames * frame_bytes);
  const std::int64_t chunk = 8 * kernels.tile_queries(a), chunks = (queries + chunk - 1) / chunk;
  for_each(frames * chunks, kernels.workspace(a), [&](std::int64_t unit, void* scratch) {
    const std::int64_t frame = unit / chunks, begin = unit % chunks * chunk;
    kernels.forward(of_frame(a, in, frame), begin, std::min(begin + chunk, queries),
                    out.data_ptr<T>() + frame * queries * a.channels, kept_of_frame(kept, frame, frame_bytes), scratch);
  });
  return out;
}

template <class T>
variable_list attention_backward(const variable_list& in, const Tensor& kept, const Tensor& out_gradient,
                                 bool bfloat16) {
  const auto& kernels = attention_kernels<T>(bfloat16);
  const PackedAttention<T> packed(in, true, bfloat16);
  const auto& a = packed.arguments;

  // A unit is a frame, or a chunk of its queries where there are few frames; a part is some consecutive units. What
  // belongs to a frame is summed per unit, what belongs to all per part.
  const std::int64_t frames = in[key].size(0), queries = in[query_position].size(1);
  const std::int64_t step = kernels.tile_queries(a), tiles = (queries + step - 1) / step;
  std::int64_t chunks = frames >= most_parts || frames == 0 ? 1 : (most_parts + frames - 1) / frames;
  chunks = std::max<std::int64_t>(1, std::min(chunks, tiles));
  const std::int64_t chunk = (tiles + chunks - 1) / chunks * step;
  const std::int64_t frame_bytes =
      queries * (a.neighbours + a.has_extra) * a.channels * std::int64_t(kernels.kept_size);
  const std::int64_t units = frames * chunks, parts = std::min(units, most_parts);

  variable_list gradients(attention_inputs);
  auto per_unit = [&](int input) {
    return input == key || input == value || input == key_position || input == extra_key || input == extra_value ||
           (input == query && a.shared_query);
  };
  auto per_part = [&](int input) { return input == logit_code || input == value_code || input == mix; };
  for (int input = 0; input < attention_inputs; ++input) {
    if (input == neighbours || !in[input].defined() || !in[input].requires_grad()) continue;
    auto sizes = in[input].sizes().vec();
    if (per_unit(input)) sizes[0] = units;
    if (per_part(input)) sizes.insert(sizes.begin(), std::max<std::int64_t>(parts, 1));
    gradients[input] = at::zeros(sizes, in[input].options().requires_grad(false));
  }
  // Where the kernel adds for one unit of one part.
  auto place = [&](int input, std::int64_t index) -> T* {
    return gradients[input].defined() ? data<T>(gradients[input]) + index * gradients[input].stride(0) : nullptr;
  };
  for_each(parts, kernels.workspace(a), [&](std::int64_t part, void* scratch) {
    for (std::int64_t unit = part * units / parts; unit < (part + 1) * units / parts; ++unit) {
      const std::int64_t frame = unit / chunks, begin = std::min(unit % chunks * chunk, queries);
      AttentionGradients<T> g;
      g.query = place(query, a.shared_query ? unit : frame);
      g.key = place(key, unit);
      g.value = place(value, unit);
      g.query_position = place(query_position, frame);
      g.key_position = place(key_position, unit);
      g.extra_key = place(extra_key, unit);
      g.extra_value = place(extra_value, unit);
      g.logit_code = place(logit_code, part);
      g.value_code = place(value_code, part);
      g.mix = place(mix, part);
      kernels.backward(of_frame(a, in, frame), begin, std::min(begin + chunk, queries),
                       data<T>(out_gradient) + frame * queries * a.channels,
                       kept.numel() > 0 ? kept_of_frame(kept, frame, frame_bytes) : nullptr, g, scratch);
    }
  });
  for (int input = 0; input < attention_inputs; ++input) {
    Tensor& gradient = gradients[input];
    if (!gradient.defined()) continue;
    if (per_part(input)) gradient = sum_in_order(gradient);
    if (per_unit(input) && chunks > 1) {
      auto sizes = in[input].sizes().vec();
      sizes.insert(sizes.begin() + 1, chunks);
      gradient = sum_in_order(gradient.view(sizes).transpose(0, 1));
    }
  }
  return gradients;
}

// LibTorch 1.13 takes no undefined tensors for arguments of a function; these stand for them.
Tensor or_placeholder(const Tensor& tensor, const Tensor& like) {
  return tensor.defined() ? tensor : at::empty({0}, like.options().requires_grad(false));
}

void drop_placeholders(variable_list& in) {
  for (const int input : {neighbours, extra_key, extra_value})
    if (in[input].dim() == 1) in[input] = Tensor();
}

struct AttentionFunction : torch::autograd::Function<AttentionFunction> {
  static Tensor forward(AutogradContext* context, bool bfloat16, bool keep, Tensor query, Tensor key, Tensor value,
                        Tensor logit_code, Tensor value_code, Tensor mix, Tensor query_position, Tensor key_position,
                        Tensor neighbours, Tensor extra_key, Tensor extra_value) {
    variable_list in{query,          key,          value,      logit_code, value_code, mix,
                     query_position, key_position, neighbours, extra_key,  extra_value};
    context->saved_data["bfloat16"] = bfloat16;
    drop_placeholders(in);
    Tensor kept;
    const Tensor out = key.scalar_type() == at::kFloat ? attention_forward<float>(in, bfloat16, keep, kept)
                                                       : attention_forward<double>(in, false, keep, kept);
    in.push_back(kept);
    context->save_for_backward(in);
    return out;
  }
  static variable_list backward(AutogradContext* context, variable_list out_gradients) {
    variable_list in = context->get_saved_variables();
    const Tensor kept = in.back();
    in.pop_back();
    const Tensor gradient = out_gradients[0].contiguous();
    variable_list gradients =
        gradient.scalar_type() == at::kFloat
            ? attention_backward<float>(in, kept, gradient, context->saved_data["bfloat16"].toBool())
            : attention_backward<double>(in, kept, gradient, false);
    gradients.insert(gradients.begin(), 2, Tensor());  // of the flags
    return gradients;
  }
};

// ---- head ----

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
    kept_tiles = std::min((rows + step - 1) / step, std::int64_t(most_kept_bytes) / 2 / tile_bytes);
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

// ---- nearest keys ----

// NaN is farther than everything.
template <class T>
bool nearer(T a, T b) {
  return a < b || (std::isnan(b) && !std::isnan(a));
}

template <class T>
void nearest_of_frame(const T* query, const T* key, std::int64_t keys, int components, int n, std::int32_t* out,
                      std::vector<T>& distance) {
  distance.resize(n);
  int found = 0;
  for (std::int64_t k = 0; k < keys; ++k) {
    T square = 0;
    for (int c = 0; c < components; ++c)
      square += (query[c] - key[k * components + c]) * (query[c] - key[k * components + c]);
    if (found == n && !nearer(square, distance[n - 1])) continue;
    int at = found < n ? found++ : n - 1;
    for (; at > 0 && nearer(square, distance[at - 1]); --at) distance[at] = distance[at - 1], out[at] = out[at - 1];
    distance[at] = square;
    out[at] = std::int32_t(k);
  }
}

template <class T>
void find_nearest(const Tensor& queries, const Tensor& keys, int n, Tensor& out) {
  const std::int64_t per_frame = queries.size(1), key_count = keys.size(1);
  const int components = int(queries.size(2));
  at::parallel_for(0, queries.size(0) * per_frame, 1024, [&](std::int64_t begin, std::int64_t end) {
    std::vector<T> distance;
    for (std::int64_t q = begin; q < end; ++q)
      nearest_of_frame(data<T>(queries) + q * components, data<T>(keys) + q / per_frame * key_count * components,
                       key_count, components, n, out.data_ptr<std::int32_t>() + q * n, distance);
  });
}

}  // namespace

bool has_bfloat16() {
  return cpu_has_bfloat16();
}

Tensor fused_attention(const AttentionTerms& terms, Precision precision) {
  check(terms.key.defined() && terms.key.dim() == 3 && terms.key_position.defined() && terms.key_position.dim() == 3 &&
            terms.query_position.defined() && terms.query_position.dim() == 3 && terms.query.defined() &&
            terms.query.dim() == 3,
        "fused_attention: queries, keys and positions have three dimensions");
  const auto type = terms.key.scalar_type();
  const std::int64_t frames = terms.key.size(0), keys = terms.key.size(1), d = terms.key.size(2);
  const std::int64_t queries = terms.query_position.size(1), components = terms.key_position.size(2);
  check(type == at::kFloat || type == at::kDouble, "fused_attention: float or double");
  check(d >= 1 && keys >= 1 && components >= 1, "fused_attention: at least one channel, key and component");
  check(type == at::kDouble || d % 16 == 0, "fused_attention: channels are a multiple of 16");
  check_precision(precision, type);
  check_tensor(terms.query, {frames, terms.query.size(1) == 1 ? 1 : queries, d}, type, "fused_attention: query");
  check_tensor(terms.key, {frames, keys, d}, type, "fused_attention: key");
  check_tensor(terms.value, {frames, keys, d}, type, "fused_attention: value");
  check_tensor(terms.logit_code, {code_rows(int(components)), d}, type, "fused_attention: logit_code");
  check_tensor(terms.value_code, {code_rows(int(components)), d}, type, "fused_attention: value_code");
  check_tensor(terms.mix, {d, d}, type, "fused_attention: mix");
  check_tensor(terms.query_position, {frames, queries, components}, type, "fused_attention: query_position");
  check_tensor(terms.key_position, {frames, keys, components}, type, "fused_attention: key_position");
  check(terms.extra_key.defined() == terms.extra_value.defined(), "fused_attention: an extra key has an extra value");
  if (terms.extra_key.defined()) {
    check_tensor(terms.extra_key, {frames, d}, type, "fused_attention: extra_key");
    check_tensor(terms.extra_value, {frames, d}, type, "fused_attention: extra_value");
  }
  if (terms.neighbours.defined()) {
    check(terms.neighbours.dim() == 3 && terms.neighbours.size(2) >= 1, "fused_attention: at least one neighbour");
    check_tensor(terms.neighbours, {frames, queries, terms.neighbours.size(2)}, at::kInt,
                 "fused_attention: neighbours");
    if (terms.neighbours.numel() > 0) {
      const auto [least, most] = at::aminmax(terms.neighbours);
      check(least.item<int>() >= 0 && most.item<int>() < keys, "fused_attention: a neighbour is one of the keys");
    }
  }
  // Only for double: channels of zeros change nothing.
  const std::int64_t more = (16 - d % 16) % 16;
  auto padded = [&](const Tensor& tensor) {
    return tensor.defined() ? pad_channels(tensor, more).contiguous() : or_placeholder(tensor, terms.key);
  };
  const variable_list inputs{terms.query,      terms.key,        terms.value,          terms.logit_code,
                             terms.value_code, terms.mix,        terms.query_position, terms.key_position,
                             terms.extra_key,  terms.extra_value};
  const Tensor out = AttentionFunction::apply(
      precision == Precision::bfloat16, will_differentiate(inputs), padded(terms.query), padded(terms.key),
      padded(terms.value), padded(terms.logit_code), padded(terms.value_code),
      pad_channels(terms.mix, more, true).contiguous(), terms.query_position.contiguous(),
      terms.key_position.contiguous(), or_placeholder(terms.neighbours, terms.key).contiguous(),
      padded(terms.extra_key), padded(terms.extra_value));
  return more ? out.narrow(2, 0, d) : out;
}

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

Tensor nearest_keys(const Tensor& query_position, const Tensor& key_position, int n) {
  check(query_position.defined() && key_position.defined() && query_position.dim() == 3 && key_position.dim() == 3 &&
            query_position.size(0) == key_position.size(0) && query_position.size(2) == key_position.size(2),
        "nearest_keys: queries and keys of the same frames and components");
  check(query_position.scalar_type() == key_position.scalar_type() && query_position.device().is_cpu() &&
            key_position.device().is_cpu(),
        "nearest_keys: positions of one type, on the CPU");
  check(n >= 1 && n <= key_position.size(1), "nearest_keys: n from 1 to the number of keys");
  const Tensor queries = query_position.detach().contiguous(), keys = key_position.detach().contiguous();
  Tensor out = at::empty({queries.size(0), queries.size(1), n}, queries.options().dtype(at::kInt).requires_grad(false));
  if (queries.scalar_type() == at::kFloat)
    find_nearest<float>(queries, keys, n, out);
  else {
    check(queries.scalar_type() == at::kDouble, "nearest_keys: float or double");
    find_nearest<double>(queries, keys, n, out);
  }
  return out;
}

}  // namespace moomill
