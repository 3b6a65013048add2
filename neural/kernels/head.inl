// Implementation of head.h for the vectors S of one instruction set. Included only by files compiled for it; see
// vector.h.
#include "neural/kernels/head.h"
#include "neural/kernels/product.h"

namespace moomill {
namespace {

template <class S>
struct Head {
  using T = typename S::Scalar;
  using Arguments = HeadArguments<T>;
  using Gradients = HeadGradients<T>;

  // Rows worked on at once: enough that products over rows pay for loading and storing their sums.
  static constexpr int most_rows = 96;
  static int tile_rows(const Arguments&) { return most_rows; }

  struct Tile {
    int rows = 0;
    const T* features = nullptr;
    std::ptrdiff_t ld = 0;
    T *net = nullptr, *last = nullptr, *out = nullptr;  // last = relu(net) at the end
    T *inner = nullptr, *outer = nullptr;               // of each block: relu(net), relu(W_1 relu(net) + b_1)
    std::ptrdiff_t block = 0;                           // from one block's to the next one's; 0 where none is kept
  };

  static Tile lay_out(const Arguments& a, bool backward, char*& at) {
    Tile tile;
    tile.ld = padded_row(a.width);
    const std::size_t size = most_rows * tile.ld;
    const int kept = backward && a.blocks > 1 ? a.blocks : 1;
    tile.block = kept > 1 ? size : 0;
    tile.net = take<T>(at, size);
    tile.last = take<T>(at, size);
    tile.inner = take<T>(at, size * kept);
    tile.outer = take<T>(at, size * kept);
    tile.out = take<T>(at, most_rows * head_outputs);
    return tile;
  }

  static std::size_t workspace(const Arguments& a, bool backward) {
    char* const start = nullptr;
    char* at = start;
    lay_out(a, backward, at);
    return std::size_t(at - start);
  }

  struct Layer {  // to = relu(sum + bias)
    T* to;
    const T* bias;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      S::store(to + row * ld + column, S::max(S::all(0), sum + S::load(bias + column)));
    }
  };
  template <bool add, bool activate>
  struct Residual {  // net = or += sum + bias; to = relu(net)
    T *net, *to;
    const T* bias;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      T* place = net + row * ld + column;
      auto x = sum + S::load(bias + column);
      if (add) x = x + S::load(place);
      S::store(place, x);
      if (activate) S::store(to + row * ld + column, S::max(S::all(0), x));
    }
  };
  struct Biased {
    T* to;
    const T* bias;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      S::store(to + row * head_outputs + column, sum + S::load(bias + column));
    }
  };
  struct Masked {  // to = sum where activation is positive, else 0; the two may be the same
    T* to;
    const T* activation;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      S::store(to + row * ld + column, S::where_positive(S::load(activation + row * ld + column), sum));
    }
  };
  struct AddMasked {
    T* to;
    const T* activation;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      T* place = to + row * ld + column;
      S::store(place, S::load(place) + S::where_positive(S::load(activation + row * ld + column), sum));
    }
  };

  // All activations of the tile's rows up to last.
  static void evaluate(const Arguments& a, Tile& tile) {
    const int d = a.features, h = a.width, rows = tile.rows;
    const std::ptrdiff_t ld = tile.ld;
    if (a.blocks == 0)
      product<S>(rows, h, d, tile.features, d, 1, a.in_t, ld,
                 Residual<false, true>{tile.net, tile.last, a.in_bias, ld});
    for (int b = 0; b < a.blocks; ++b) {
      T *inner = tile.inner + b * tile.block, *outer = tile.outer + b * tile.block;
      if (b == 0)
        product<S>(rows, h, d, tile.features, d, 1, a.in_t, ld, Residual<false, true>{tile.net, inner, a.in_bias, ld});
      else
        product<S>(rows, h, d, tile.features, d, 1, a.feature_t + b * d * ld, ld,
                   Residual<true, true>{tile.net, inner, a.feature_bias + b * h, ld});
      product<S>(rows, h, h, inner, ld, 1, a.first_t + b * h * ld, ld, Layer{outer, a.first_bias + b * h, ld});
      const T *second = a.second_t + b * h * ld, *bias = a.second_bias + b * h;
      if (b + 1 < a.blocks)
        product<S>(rows, h, h, outer, ld, 1, second, ld, Residual<true, false>{tile.net, nullptr, bias, ld});
      else
        product<S>(rows, h, h, outer, ld, 1, second, ld, Residual<true, true>{tile.net, tile.last, bias, ld});
    }
  }

  static void forward(const Arguments& a, const T* features, std::int64_t begin, std::int64_t end, T* out,
                      void* memory) {
    char* at = static_cast<char*>(memory);
    Tile tile = lay_out(a, false, at);
    for (std::int64_t row = begin; row < end; row += most_rows) {
      tile.rows = int(end - row < most_rows ? end - row : most_rows);
      tile.features = features + row * a.features;
      evaluate(a, tile);
      product<S>(tile.rows, head_outputs, a.width, tile.last, tile.ld, 1, a.out_t, head_outputs,
                 Biased{tile.out, a.out_bias});
      for (int r = 0; r < tile.rows; ++r)
        for (int o = 0; o < a.outputs; ++o) out[(row + r) * a.outputs + o] = tile.out[r * head_outputs + o];
    }
  }

  static void add_column_sums(const T* from, int rows, int columns, std::ptrdiff_t ld, T* to) {
    for (int c = 0; c < columns; c += S::width) {
      auto sum = S::all(0);
      for (int r = 0; r < rows; ++r) sum = sum + S::load(from + r * ld + c);
      S::store(to + c, S::load(to + c) + sum);
    }
  }

  // Gradients of a layer's weights [h, columns] and bias from those of its outputs, [rows, h] at gradient.
  static void layer_gradients(const Tile& tile, int h, const T* gradient, const T* input, std::ptrdiff_t ld_input,
                              int columns, T* weight, T* bias) {
    product<S>(h, columns, tile.rows, gradient, 1, tile.ld, input, ld_input, Add<S>{weight, columns});
    add_column_sums(gradient, tile.rows, h, tile.ld, bias);
  }

  static void backward(const Arguments& a, const T* features, std::int64_t begin, std::int64_t end,
                       const T* out_gradient, const Gradients& g, void* memory) {
    char* at = static_cast<char*>(memory);
    Tile tile = lay_out(a, true, at);
    const int d = a.features, h = a.width;
    const std::ptrdiff_t ld = tile.ld, ld_in = padded_row(d);
    T* const net = tile.net;  // from here on, its gradient
    for (std::int64_t row = begin; row < end; row += most_rows) {
      const int rows = tile.rows = int(end - row < most_rows ? end - row : most_rows);
      tile.features = features + row * d;
      T* features_gradient = g.features ? g.features + row * d : nullptr;
      evaluate(a, tile);

      const T* gradient = out_gradient + row * a.outputs;
      product<S>(rows, h, a.outputs, gradient, a.outputs, 1, a.out, h, Masked{net, tile.last, ld});
      if (g.out) {
        product<S>(a.outputs, h, rows, gradient, 1, a.outputs, tile.last, ld, Add<S>{g.out, h});
        for (int r = 0; r < rows; ++r)
          for (int o = 0; o < a.outputs; ++o) g.out_bias[o] += gradient[r * a.outputs + o];
      }
      for (int b = a.blocks - 1; b >= 0; --b) {
        T *inner = tile.inner + b * tile.block, *outer = tile.outer + b * tile.block;
        if (g.in) layer_gradients(tile, h, net, outer, ld, h, g.second + b * h * h, g.second_bias + b * h);
        product<S>(rows, h, h, net, ld, 1, a.second + b * h * ld, ld, Masked{outer, outer, ld});
        if (g.in) layer_gradients(tile, h, outer, inner, ld, h, g.first + b * h * h, g.first_bias + b * h);
        product<S>(rows, h, h, outer, ld, 1, a.first + b * h * ld, ld, AddMasked{net, inner, ld});
        if (b == 0) break;
        if (g.in) layer_gradients(tile, h, net, tile.features, d, d, g.feature + b * h * d, g.feature_bias + b * h);
        if (!features_gradient) continue;
        const T* feature = a.feature + b * h * ld_in;
        if (b == a.blocks - 1)
          product<S>(rows, d, h, net, ld, 1, feature, ld_in, Store<S>{features_gradient, d});
        else
          product<S>(rows, d, h, net, ld, 1, feature, ld_in, Add<S>{features_gradient, d});
      }
      if (g.in) layer_gradients(tile, h, net, tile.features, d, d, g.in, g.in_bias);
      if (features_gradient) {
        if (a.blocks <= 1)
          product<S>(rows, d, h, net, ld, 1, a.in, ld_in, Store<S>{features_gradient, d});
        else
          product<S>(rows, d, h, net, ld, 1, a.in, ld_in, Add<S>{features_gradient, d});
      }
    }
  }

  static constexpr HeadKernels<T> kernels{workspace, forward, backward, tile_rows};
};

}  // namespace
}  // namespace moomill
