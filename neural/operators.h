#pragma once
// Fused operators: forward and backward in tiles that stay in cache, recomputing instead of storing. CPU only; the plain
// LibTorch versions they are held against are in networks.cpp. Float (AVX-512 or AVX2, chosen at run time) and double
// (for gradient checks). The same bits for any number of threads: work is split by frame, weight gradients are summed in
// a fixed order. Where a backward pass will follow and memory is cheaper than arithmetic, some activations are kept after all, at
// most a GiB a call.
#include <torch/torch.h>

#include <vector>

namespace moomill {

// bfloat16: factors of the matrix products (but those of a head's last layer), forward and backward; sums, positions, softmax and
// everything between are float. About 0.2 % off on average, twice as fast.
enum class Precision { float32, bfloat16 };

// Whether this processor multiplies bfloat16 (AVX512-BF16). Elsewhere Precision::bfloat16 is refused with an InputError.
bool has_bfloat16();

// Vector attention after the exact rearrangement of its first layer (netepu: edge = W_q x_i - W_k x_j + e(p_i - p_j), e linear):
//   hidden_ij = relu(query_i - key_j + logit_code^T g(p_i - p_j))
//   logit_ij  = mix hidden_ij                                  (the bias is the same for all j: it drops out of the softmax)
//   out_i     = sum_j softmax_j(logit_ij) * (value_j + value_code^T g(p_i - p_j)), per channel
// g(d) of D components: [d, sin(f_0 d), cos(f_0 d), ..., sin(f_4 d), cos(f_4 d)], each D wide, f_k = 1 + 7.75 k.
struct AttentionTerms {
  torch::Tensor query;           // [B, M, d], or [B, 1, d]: one for all queries of a frame
  torch::Tensor key;             // [B, K, d]
  torch::Tensor value;           // [B, K, d]
  torch::Tensor logit_code;      // [11 D, d]
  torch::Tensor value_code;      // [11 D, d]
  torch::Tensor mix;             // [d, d], rows are outputs
  torch::Tensor query_position;  // [B, M, D]
  torch::Tensor key_position;    // [B, K, D]
  torch::Tensor neighbours;      // int32 [B, M, n], keys a query attends to; undefined: all K
  torch::Tensor extra_key;       // [B, d] one more key with zero positional code (g and its bias 0); undefined: none
  torch::Tensor extra_value;     // [B, d]
};

// [B, M, d]. Differentiable in everything but neighbours (positions only where they require a gradient).
torch::Tensor fused_attention(const AttentionTerms& terms, Precision precision = Precision::float32);

// Residual perceptron of a head (Mescheder et al., Occupancy Networks, 2019):
//   net = W_in y + b_in;  for each block: net += W_c y + b_c;  net += W_2 relu(W_1 relu(net) + b_1) + b_2;  out = W_out relu(net) + b_out
struct HeadWeights {
  torch::Tensor in_weight, in_bias;        // [h, d], [h]
  torch::Tensor feature_weight, feature_bias;  // [n, h, d], [n, h]
  torch::Tensor first_weight, first_bias;  // [n, h, h], [n, h]
  torch::Tensor second_weight, second_bias;
  torch::Tensor out_weight, out_bias;      // [o, h], [o]; o from 1 to 16
};

// features [P, d] to [P, o]. Differentiable in everything.
torch::Tensor fused_head(const torch::Tensor& features, const HeadWeights& weights, Precision precision = Precision::float32);

// The n keys nearest to each query by Euclidean distance, nearest first, ties by index. [B, M, D], [B, K, D] to int32 [B, M, n].
torch::Tensor nearest_keys(const torch::Tensor& query_position, const torch::Tensor& key_position, int n);

}  // namespace moomill
