// Vector attention as an autograd function over kernels/attention.h.
#include "neural/kernels/attention.h"
#include "neural/kernels/cpu.h"
#include "neural/operator_tools.h"

namespace moomill {

namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

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
    kept_frames = std::min(frames, most_kept_bytes.load() / frame_bytes);
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

Tensor pad_channels(const Tensor& tensor, std::int64_t more, bool rows_too = false) {
  if (more == 0) return tensor;
  return rows_too ? at::constant_pad_nd(tensor, {0, more, 0, more}) : at::constant_pad_nd(tensor, {0, more});
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

}  // namespace moomill
