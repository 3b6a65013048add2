// Implementation of head.h; Format: of the activations and weights in the products. Included only by files compiled for
// it; see vector.h.
#include "neural/kernels/format.h"
#include "neural/kernels/head.h"
#include "neural/kernels/product.h"

namespace moomill {
namespace {

template <class Format>
struct Head {
  using S = typename Format::S;
  using T = typename Format::T;
  using Element = typename Format::Element;
  using Arguments = HeadArguments<T>;
  using Gradients = HeadGradients<T>;

  // Rows worked on at once: enough that products over rows pay for loading and storing their sums.
  static constexpr int most_rows = 96;
  static int tile_rows(const Arguments&) { return most_rows; }

  struct Tile {
    int rows = 0;
    std::ptrdiff_t ld = 0;                       // of all with h columns
    T *net = nullptr, *last = nullptr;           // last = relu(net) at the end
    Element *inner = nullptr, *outer = nullptr;  // of each block: relu(net), relu(W_1 relu(net) + b_1)
    std::ptrdiff_t block = 0;                    // from one block's to the next one's; 0 where none is kept
    const Element* features = nullptr;
    std::ptrdiff_t features_ld = 0;
    Element* features_copy = nullptr;  // where their format is not that of the caller
    Element* net_copy = nullptr;       // of the gradient of net; else the same
    Element* layer_gradient = nullptr;
    T* out = nullptr;
    void *net_columns = nullptr, *layer_columns = nullptr, *features_columns = nullptr;
  };

  // Where a tile's activations go that the backward pass needs.
  static void lay_out_activations(const Arguments& a, bool backward, char*& at, Tile& tile) {
    const std::size_t size = most_rows * tile.ld;
    const int blocks = backward && a.blocks > 1 ? a.blocks : 1;
    tile.block = blocks > 1 ? size : 0;
    tile.last = take<T>(at, size);
    tile.inner = take<Element>(at, size * blocks);
    tile.outer = take<Element>(at, size * blocks);
  }

  // The same in the caller's memory.
  static void lay_out_kept(const Arguments& a, const void* kept, std::int64_t row, Tile& tile) {
    char* at = const_cast<char*>(static_cast<const char*>(kept)) + row / most_rows * kept_bytes(a);
    lay_out_activations(a, true, at, tile);
  }

  static Tile lay_out(const Arguments& a, bool backward, char*& at) {
    Tile tile;
    tile.ld = padded_row(a.width);
    tile.features_ld = Format::half ? padded_row(a.features) : a.features;
    const std::size_t size = most_rows * tile.ld;
    lay_out_activations(a, backward, at, tile);
    tile.net = take<T>(at, size);
    tile.out = take<T>(at, most_rows * head_outputs);
    if (Format::half) tile.features_copy = take<Element>(at, most_rows * tile.features_ld);
    tile.net_copy = Format::half && backward ? take<Element>(at, size) : nullptr;
    if (!backward) return tile;
    tile.layer_gradient = take<Element>(at, size);
    if constexpr (Format::half) {
      tile.net_columns = take<char>(at, Format::columns_bytes(most_rows, a.width));
      tile.layer_columns = take<char>(at, 2 * Format::columns_bytes(most_rows, a.width));
      tile.features_columns = take<char>(at, Format::columns_bytes(most_rows, a.features));
    } else {
      tile.net_copy = tile.net;
    }
    return tile;
  }

  static std::size_t workspace(const Arguments& a, bool backward) {
    char* const start = nullptr;
    char* at = start;
    lay_out(a, backward, at);
    return std::size_t(at - start);
  }

  static std::size_t kept_bytes(const Arguments& a) {
    char* const start = nullptr;
    char* at = start;
    Tile tile;
    tile.ld = padded_row(a.width);
    lay_out_activations(a, true, at, tile);
    return std::size_t(at - start);
  }

  struct Layer {  // to = relu(sum + bias)
    Element* to;
    const T* bias;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      Format::store(to + row * ld + column, S::max(S::all(0), sum + S::load(bias + column)));
    }
  };
  template <bool add, bool activate>
  struct Residual {  // net = or += sum + bias; to = relu(net)
    T* net;
    Element* to;
    const T* bias;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      T* place = net + row * ld + column;
      auto x = sum + S::load(bias + column);
      if (add) x = x + S::load(place);
      S::store(place, x);
      if (activate) Format::store(to + row * ld + column, S::max(S::all(0), x));
    }
  };
  template <bool add>
  struct Last {  // to = relu(sum + bias (+ to)), in the format of net
    T* to;
    const T *bias, *net;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      auto x = sum + S::load(bias + column);
      if (add) x = x + S::load(net + row * ld + column);
      S::store(to + row * ld + column, S::max(S::all(0), x));
    }
  };
  struct Biased {
    T* to;
    const T* bias;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      S::store(to + row * head_outputs + column, sum + S::load(bias + column));
    }
  };
  struct LastGradient {  // to = sum where activation is positive, else 0
    T* to;
    Element* copy;
    const T* activation;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      const std::ptrdiff_t place = row * ld + column;
      const auto x = S::where_positive(S::load(activation + place), sum);
      S::store(to + place, x);
      if (Format::half) Format::store(copy + place, x);
    }
  };
  struct LayerGradient {  // to = sum where activation is positive, else 0
    Element* to;
    const Element* activation;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      const std::ptrdiff_t place = row * ld + column;
      Format::store(to + place, Format::where_positive(activation + place, sum));
    }
  };
  struct NetGradient {  // to += sum where activation is positive
    T* to;
    Element* copy;
    const Element* activation;
    std::ptrdiff_t ld;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      const std::ptrdiff_t place = row * ld + column;
      const auto x = S::load(to + place) + Format::where_positive(activation + place, sum);
      S::store(to + place, x);
      if (Format::half) Format::store(copy + place, x);
    }
  };

  // Makes the features ready for products.
  static void take_features(const Arguments& a, const T* features, Tile& tile) {
    if constexpr (Format::half) {
      const int d = a.features;
      for (int r = 0; r < tile.rows; ++r)
        for (int c = 0; c < d; c += S::width)
          Format::store(tile.features_copy + r * tile.features_ld + c, S::load(features + std::ptrdiff_t(r) * d + c));
      tile.features = tile.features_copy;
    } else {
      tile.features = features;
    }
  }

  // All activations of the tile's rows up to last.
  static void evaluate(const Arguments& a, Tile& tile) {
    const int d = a.features, h = a.width, rows = tile.rows;
    const std::ptrdiff_t ld = tile.ld, feature_size = Format::weight_size(d, ld),
                         layer_size = Format::weight_size(h, ld);
    auto of_features = [&](const T* weight, auto out) {
      Format::product_of_rows(rows, h, d, tile.features, tile.features_ld, weight, ld, out);
    };
    auto of_layer = [&](const Element* layer, const T* weight, auto out) {
      Format::product_of_rows(rows, h, h, layer, ld, weight, ld, out);
    };
    if (a.blocks == 0) of_features(a.in_t, Last<false>{tile.last, a.in_bias, nullptr, ld});
    for (int b = 0; b < a.blocks; ++b) {
      Element *inner = tile.inner + b * tile.block, *outer = tile.outer + b * tile.block;
      if (b == 0)
        of_features(a.in_t, Residual<false, true>{tile.net, inner, a.in_bias, ld});
      else
        of_features(a.feature_t + b * feature_size, Residual<true, true>{tile.net, inner, a.feature_bias + b * h, ld});
      of_layer(inner, a.first_t + b * layer_size, Layer{outer, a.first_bias + b * h, ld});
      const T *second = a.second_t + b * layer_size, *bias = a.second_bias + b * h;
      if (b + 1 < a.blocks)
        of_layer(outer, second, Residual<true, false>{tile.net, nullptr, bias, ld});
      else
        of_layer(outer, second, Last<true>{tile.last, bias, tile.net, ld});
    }
  }

  static void forward(const Arguments& a, const T* features, std::int64_t begin, std::int64_t end, T* out, void* kept,
                      std::int64_t kept_rows, void* memory) {
    char* at = static_cast<char*>(memory);
    const Tile scratch = lay_out(a, false, at);
    for (std::int64_t row = begin; row < end; row += most_rows) {
      Tile tile = scratch;
      tile.rows = int(end - row < most_rows ? end - row : most_rows);
      take_features(a, features + row * a.features, tile);
      if (row < kept_rows) lay_out_kept(a, kept, row, tile);
      evaluate(a, tile);
      product<S>(tile.rows, head_outputs, a.width, tile.last, tile.ld, 1, a.out_t, head_outputs,
                 Biased{tile.out, a.out_bias});
      for (int r = 0; r < tile.rows; ++r)
        for (int o = 0; o < a.outputs; ++o) out[(row + r) * a.outputs + o] = tile.out[r * head_outputs + o];
    }
  }

  // Numbers: S or Format, whose numbers from holds.
  template <class Numbers, class From>
  static void add_column_sums(const From* from, int rows, int columns, std::ptrdiff_t ld, T* to) {
    for (int c = 0; c < columns; c += S::width) {
      auto sum = S::all(0);
      for (int r = 0; r < rows; ++r) sum = sum + Numbers::load(from + r * ld + c);
      S::store(to + c, S::load(to + c) + sum);
    }
  }

  static void backward(const Arguments& a, const T* features, std::int64_t begin, std::int64_t end,
                       const T* out_gradient, const void* kept, std::int64_t kept_rows, const Gradients& g,
                       void* memory) {
    char* at = static_cast<char*>(memory);
    const Tile scratch = lay_out(a, true, at);
    const int d = a.features, h = a.width;
    const std::ptrdiff_t ld = scratch.ld, ld_in = padded_row(d);
    const std::ptrdiff_t layer_size = Format::weight_size(h, ld), feature_size = Format::weight_size(h, ld_in);
    T* const net = scratch.net;  // from here on, its gradient
    char *const inputs = static_cast<char*>(scratch.layer_columns), *const outputs =
                                                                        inputs + Format::columns_bytes(most_rows, h);
    for (std::int64_t row = begin; row < end; row += most_rows) {
      Tile tile = scratch;
      const int rows = tile.rows = int(end - row < most_rows ? end - row : most_rows);
      T* features_gradient = g.features ? g.features + row * d : nullptr;
      take_features(a, features + row * d, tile);
      if (row < kept_rows)
        lay_out_kept(a, kept, row, tile);
      else
        evaluate(a, tile);
      auto columns = [&](const Element* x, void* to) { return Format::columns(x, rows, h, ld, to); };
      typename Format::Columns features_columns{};
      if (g.in) features_columns = Format::columns(tile.features, rows, d, tile.features_ld, tile.features_columns);
      // Gradients of a layer from those of its outputs.
      auto add_layer = [&](typename Format::Columns gradient, typename Format::Columns input, int width, T* weight) {
        Format::product_of_columns(h, width, rows, gradient, input, Add<S>{weight, width});
      };
      bool first_use = true;  // of features_gradient
      auto add_features = [&](const T* weight) {
        if (!features_gradient) return;
        if (first_use)
          Format::product_of_rows(rows, d, h, tile.net_copy, ld, weight, ld_in, Store<S>{features_gradient, d});
        else
          Format::product_of_rows(rows, d, h, tile.net_copy, ld, weight, ld_in, Add<S>{features_gradient, d});
        first_use = false;
      };

      const T* gradient = out_gradient + row * a.outputs;
      product<S>(rows, h, a.outputs, gradient, a.outputs, 1, a.out, h, LastGradient{net, tile.net_copy, tile.last, ld});
      typename Format::Columns net_columns{};
      if (g.in) {
        product<S>(a.outputs, h, rows, gradient, 1, a.outputs, tile.last, ld, Add<S>{g.out, h});
        for (int r = 0; r < rows; ++r)
          for (int o = 0; o < a.outputs; ++o) g.out_bias[o] += gradient[r * a.outputs + o];
        net_columns = columns(tile.net_copy, tile.net_columns);
      }
      for (int b = a.blocks - 1; b >= 0; --b) {
        const Element *inner = tile.inner + b * tile.block, *outer = tile.outer + b * tile.block;
        Element* const layer = tile.layer_gradient;
        if (g.in) {
          add_layer(net_columns, columns(outer, inputs), h, g.second + b * h * h);
          add_column_sums<S>(net, rows, h, ld, g.second_bias + b * h);
        }
        Format::product_of_rows(rows, h, h, tile.net_copy, ld, a.second + b * layer_size, ld,
                                LayerGradient{layer, outer, ld});
        if (g.in) {
          add_layer(columns(layer, outputs), columns(inner, inputs), h, g.first + b * h * h);
          add_column_sums<Format>(layer, rows, h, ld, g.first_bias + b * h);
        }
        Format::product_of_rows(rows, h, h, layer, ld, a.first + b * layer_size, ld,
                                NetGradient{net, tile.net_copy, inner, ld});
        if (g.in) net_columns = columns(tile.net_copy, tile.net_columns);
        if (b == 0) break;
        if (g.in) {
          add_layer(net_columns, features_columns, d, g.feature + b * h * d);
          add_column_sums<S>(net, rows, h, ld, g.feature_bias + b * h);
        }
        add_features(a.feature + b * feature_size);
      }
      if (g.in) {
        add_layer(net_columns, features_columns, d, g.in);
        add_column_sums<S>(net, rows, h, ld, g.in_bias);
      }
      add_features(a.in);
    }
  }

  static constexpr HeadKernels<T> kernels{workspace, forward, backward, tile_rows, kept_bytes};
};

}  // namespace
}  // namespace moomill
