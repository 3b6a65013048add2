// Implementation of attention.h; Format: of the numbers in the products. Included only by files compiled
// for it; see vector.h.
#include "neural/kernels/attention.h"
#include "neural/kernels/format.h"
#include "neural/kernels/position_code.h"
#include "neural/kernels/product.h"

namespace moomill {
namespace {

// About this many pairs of query and key are worked on at once: the three buffers of a tile stay in the L2 cache (in L1
// for d = 64), and products over pairs are long enough to pay for loading and storing their sums.
constexpr int tile_pairs = 128;

template <class Format>
struct Attention {
  using S = typename Format::S;
  using T = typename Format::T;
  using Element = typename Format::Element;
  using Arguments = AttentionArguments<T>;
  using Gradients = AttentionGradients<T>;

  static int pairs_per_query(const Arguments& a) { return a.neighbours + (a.has_extra ? 1 : 0); }

  static int tile_queries(const Arguments& a) {
    const int fit = tile_pairs / pairs_per_query(a);
    return fit > 1 ? fit : 1;
  }

  // Buffers of a tile and what its pairs refer to. Pairs of one query are consecutive, the extra key is the last.
  struct Tile {
    int queries = 0, pairs = 0;
    std::ptrdiff_t ld = 0, code_stride = 0;
    T* code = nullptr;          // [11 D, pairs]
    Element* hidden = nullptr;  // [pairs, d] as the three after it
    T *logit = nullptr, *value = nullptr;
    Element* logit_gradient = nullptr;  // may take the place of logit
    T* hidden_gradient = nullptr;       // may take the place of hidden
    // Only for bfloat16: the code and gradients once more, and two matrices at a time made ready to be summed over
    // pairs.
    Element *code_copy = nullptr, *hidden_gradient_copy = nullptr, *value_gradient_copy = nullptr;
    void *code_columns = nullptr, *columns[2] = {};
    T *code_gradient = nullptr, *difference_gradient = nullptr;
    const T **query_row = nullptr, **key_row = nullptr, **value_row = nullptr;
    int* key_index = nullptr;  // of each pair; -1 for the extra key
  };

  static Tile lay_out(const Arguments& a, char*& at) {
    const std::size_t most = std::size_t(tile_queries(a)) * pairs_per_query(a), padded = (most + 15) / 16 * 16;
    Tile tile;
    tile.ld = padded_row(a.channels);
    tile.code_stride = padded;
    tile.code = take<T>(at, code_rows(a.components) * padded);
    tile.hidden = take<Element>(at, most * tile.ld);
    tile.logit = take<T>(at, most * tile.ld);
    tile.value = take<T>(at, most * tile.ld);
    if constexpr (Format::half) {
      tile.logit_gradient = take<Element>(at, most * tile.ld);
      tile.hidden_gradient = take<T>(at, most * tile.ld);
      tile.code_copy = take<Element>(at, code_rows(a.components) * padded);
      tile.hidden_gradient_copy = take<Element>(at, most * tile.ld);
      tile.value_gradient_copy = take<Element>(at, most * tile.ld);
      tile.code_columns = take<char>(at, Format::columns_bytes(code_rows(a.components), int(padded)));
      for (void*& columns : tile.columns) columns = take<char>(at, Format::columns_bytes(int(most), a.channels));
    } else {
      tile.logit_gradient = tile.logit;
      tile.hidden_gradient = tile.hidden;
    }
    tile.code_gradient = take<T>(at, most * code_columns(a.components));
    tile.difference_gradient = take<T>(at, most * a.components);
    tile.query_row = take<const T*>(at, most);
    tile.key_row = take<const T*>(at, most);
    tile.value_row = take<const T*>(at, most);
    tile.key_index = take<int>(at, most);
    return tile;
  }

  static std::size_t workspace(const Arguments& a) {
    char* const start = nullptr;
    char* at = start;
    lay_out(a, at);
    return std::size_t(at - start);
  }

  struct Hidden {  // relu(query - key + sum); NaN stays NaN
    const Tile& tile;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      const auto x = S::load(tile.query_row[row] + column) - S::load(tile.key_row[row] + column) + sum;
      Format::store(tile.hidden + row * tile.ld + column, S::max(S::all(0), x));
    }
  };
  struct Value {
    const Tile& tile;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      S::store(tile.value + row * tile.ld + column, S::load(tile.value_row[row] + column) + sum);
    }
  };
  struct HiddenGradient {
    const Tile& tile;
    MOOMILL_INLINE void operator()(int row, int column, typename S::Vector sum) const {
      const std::ptrdiff_t place = row * tile.ld + column;
      const auto gradient = Format::where_positive(tile.hidden + place, sum);
      S::store(tile.hidden_gradient + place, gradient);
      if (Format::half) Format::store(tile.hidden_gradient_copy + place, gradient);
    }
  };

  // Fills in code, hidden, value and, where asked, logit for queries [begin, begin + tile.queries).
  static void prepare(const Arguments& a, std::int64_t begin, int queries, bool with_logits, Tile& tile) {
    const int per_query = pairs_per_query(a), d = a.channels, components = a.components;
    tile.queries = queries;
    tile.pairs = queries * per_query;
    int pair = 0;
    for (int t = 0; t < queries; ++t) {
      const std::int64_t query = begin + t;
      const T* query_row = a.query + (a.shared_query ? 0 : query * d);
      for (int j = 0; j < per_query; ++j, ++pair) {
        const bool extra = j == a.neighbours;
        const int key = extra ? -1 : a.neighbour ? a.neighbour[query * a.neighbours + j] : j;
        tile.key_index[pair] = key;
        tile.query_row[pair] = query_row;
        tile.key_row[pair] = extra ? a.extra_key : a.key + std::ptrdiff_t(key) * d;
        tile.value_row[pair] = extra ? a.extra_value : a.value + std::ptrdiff_t(key) * d;
        for (int c = 0; c < components; ++c)
          tile.code[c * tile.code_stride + pair] =
              extra ? T(0)
                    : a.query_position[query * components + c] - a.key_position[std::ptrdiff_t(key) * components + c];
      }
    }
    const int padded = (tile.pairs + S::width - 1) / S::width * S::width;
    for (; pair < padded; ++pair)
      for (int c = 0; c < components; ++c) tile.code[c * tile.code_stride + pair] = 0;
    position_code<S>(components, padded, tile.code, tile.code_stride);
    if (a.has_extra)
      for (int row = 0; row < code_rows(components); ++row)
        for (int t = 0; t < queries; ++t) tile.code[row * tile.code_stride + t * per_query + a.neighbours] = 0;

    const int rows = code_rows(components);
    typename Format::Columns code{};
    if constexpr (Format::half) {
      for (int row = 0; row < rows; ++row)
        for (int p = 0; p < padded; p += S::width)
          Format::store(tile.code_copy + row * tile.code_stride + p, S::load(tile.code + row * tile.code_stride + p));
      code = Format::columns(tile.code_copy, rows, padded, tile.code_stride, tile.code_columns);
    } else {
      code = Format::columns(tile.code, rows, padded, tile.code_stride, nullptr);
    }
    const typename Format::Columns logit_code = Format::packed(a.logit_code, tile.ld);
    const typename Format::Columns value_code = Format::packed(a.value_code, tile.ld);
    Format::product_of_columns(tile.pairs, d, rows, code, logit_code, Hidden{tile});
    if (with_logits)
      Format::product_of_rows(tile.pairs, d, d, tile.hidden, tile.ld, a.mix_transposed, tile.ld,
                              Store<S>{tile.logit, tile.ld});
    Format::product_of_columns(tile.pairs, d, rows, code, value_code, Value{tile});
  }

  // The greatest of count logits, ld apart, times log2 e.
  static MOOMILL_INLINE typename S::Vector greatest(const T* logit, int count, std::ptrdiff_t ld) {
    auto most = S::load(logit);
    for (int j = 1; j < count; ++j) most = S::max(most, S::load(logit + j * ld));
    return most * S::all(T(log2_e));
  }
  static constexpr double log2_e = 1.4426950408889634;

  // A NaN among the logits may be lost in the maximum, but not in its own exponential, and so not in the sum.
  // kept: where exponentials go for the backward pass, or null.
  static void soften(const Arguments& a, const Tile& tile, T* out, Element* kept) {
    const int count = pairs_per_query(a);
    for (int t = 0; t < tile.queries; ++t)
      for (int c = 0; c < a.channels; c += S::width) {
        const T *logit = tile.logit + t * count * tile.ld + c, *value = tile.value + t * count * tile.ld + c;
        const auto most = greatest(logit, count, tile.ld);
        auto sum = S::all(0), weighted = S::all(0);
        for (int j = 0; j < count; ++j) {
          const auto e = exp2_of_negative<S>(S::load(logit + j * tile.ld) * S::all(T(log2_e)) - most);
          if (kept) Format::store(kept + (t * count + j) * std::ptrdiff_t(a.channels) + c, e);
          sum = sum + e;
          weighted = S::fma(e, S::load(value + j * tile.ld), weighted);
        }
        S::store(out + std::ptrdiff_t(t) * a.channels + c, weighted / sum);
      }
  }

  static void forward(const Arguments& a, std::int64_t begin, std::int64_t end, T* out, void* kept, void* memory) {
    char* at = static_cast<char*>(memory);
    Tile tile = lay_out(a, at);
    const int step = tile_queries(a);
    const std::ptrdiff_t per_query = std::ptrdiff_t(pairs_per_query(a)) * a.channels;
    for (std::int64_t query = begin; query < end; query += step) {
      prepare(a, query, int(end - query < step ? end - query : step), true, tile);
      soften(a, tile, out + query * a.channels, kept ? static_cast<Element*>(kept) + query * per_query : nullptr);
    }
  }

  // From the gradient of out: logit_gradient is filled in, and value becomes its own gradient. kept: exponentials of
  // the forward pass; null: from the logits, which they replace.
  static void soften_backward(const Arguments& a, Tile& tile, const T* out_gradient, const Element* kept) {
    const int count = pairs_per_query(a);
    for (int t = 0; t < tile.queries; ++t)
      for (int c = 0; c < a.channels; c += S::width) {
        T *logit = tile.logit + t * count * tile.ld + c, *value = tile.value + t * count * tile.ld + c;
        const Element* exponential = kept ? kept + t * count * std::ptrdiff_t(a.channels) + c : nullptr;
        auto sum = S::all(0), weighted = S::all(0);
        if (kept) {
          for (int j = 0; j < count; ++j) {
            const auto e = Format::load(exponential + j * std::ptrdiff_t(a.channels));
            sum = sum + e;
            weighted = S::fma(e, S::load(value + j * tile.ld), weighted);
          }
        } else {
          const auto most = greatest(logit, count, tile.ld);
          for (int j = 0; j < count; ++j) {
            const auto e = exp2_of_negative<S>(S::load(logit + j * tile.ld) * S::all(T(log2_e)) - most);
            S::store(logit + j * tile.ld, e);
            sum = sum + e;
            weighted = S::fma(e, S::load(value + j * tile.ld), weighted);
          }
        }
        const auto out = weighted / sum;
        const auto scaled = S::load(out_gradient + std::ptrdiff_t(t) * a.channels + c) / sum;
        for (int j = 0; j < count; ++j) {
          const auto e =
              kept ? Format::load(exponential + j * std::ptrdiff_t(a.channels)) : S::load(logit + j * tile.ld);
          const auto value_gradient = e * scaled;
          const auto v = S::load(value + j * tile.ld);
          S::store(value + j * tile.ld, value_gradient);
          if (Format::half) Format::store(tile.value_gradient_copy + (t * count + j) * tile.ld + c, value_gradient);
          Format::store(tile.logit_gradient + (t * count + j) * tile.ld + c, value_gradient * (v - out));
        }
      }
  }

  static MOOMILL_INLINE void add(T* to, const T* from, int count, T factor) {
    for (int c = 0; c < count; c += S::width)
      S::store(to + c, S::fma(S::load(from + c), S::all(factor), S::load(to + c)));
  }

  // Gradients of queries, keys and values from those of the pairs.
  static void scatter(const Arguments& a, std::int64_t begin, const Tile& tile, const Gradients& gradients) {
    const int count = pairs_per_query(a), d = a.channels;
    for (int t = 0; t < tile.queries; ++t) {
      if (gradients.query) {
        T* to = gradients.query + (a.shared_query ? 0 : (begin + t) * d);
        for (int c = 0; c < d; c += S::width) {
          auto sum = a.shared_query ? S::load(to + c) : S::all(0);
          for (int j = 0; j < count; ++j) sum = sum + S::load(tile.hidden_gradient + (t * count + j) * tile.ld + c);
          S::store(to + c, sum);
        }
      }
      for (int pair = t * count; pair < (t + 1) * count; ++pair) {
        const std::ptrdiff_t key = tile.key_index[pair];
        T* key_gradient = key < 0 ? gradients.extra_key : gradients.key ? gradients.key + key * d : nullptr;
        T* value_gradient = key < 0 ? gradients.extra_value : gradients.value ? gradients.value + key * d : nullptr;
        if (key_gradient) add(key_gradient, tile.hidden_gradient + pair * tile.ld, d, T(-1));
        if (value_gradient) add(value_gradient, tile.value + pair * tile.ld, d, T(1));
      }
    }
  }

  static const Element* hidden_gradient(const Tile& tile) {
    if constexpr (Format::half)
      return tile.hidden_gradient_copy;
    else
      return tile.hidden_gradient;
  }
  static const Element* value_gradient(const Tile& tile) {
    if constexpr (Format::half)
      return tile.value_gradient_copy;
    else
      return tile.value;
  }

  static void position_gradients(const Arguments& a, std::int64_t begin, const Tile& tile, const Gradients& gradients) {
    const int count = pairs_per_query(a), d = a.channels, components = a.components, columns = code_columns(components);
    const std::ptrdiff_t ld = padded_row(columns);
    Format::product_of_rows(tile.pairs, columns, d, hidden_gradient(tile), tile.ld, a.logit_code_transposed, ld,
                            Store<S>{tile.code_gradient, columns});
    Format::product_of_rows(tile.pairs, columns, d, value_gradient(tile), tile.ld, a.value_code_transposed, ld,
                            Add<S>{tile.code_gradient, columns});
    position_code_backward<S>(components, tile.pairs, tile.code, tile.code_stride, tile.code_gradient, columns,
                              tile.difference_gradient);
    for (int t = 0; t < tile.queries; ++t)
      for (int c = 0; c < components; ++c) {
        T sum = 0;
        for (int pair = t * count; pair < t * count + a.neighbours; ++pair) {
          const T g = tile.difference_gradient[pair * components + c];
          sum += g;
          if (gradients.key_position)
            gradients.key_position[std::ptrdiff_t(tile.key_index[pair]) * components + c] -= g;
        }
        if (gradients.query_position) gradients.query_position[(begin + t) * components + c] = sum;
      }
  }

  static void backward(const Arguments& a, std::int64_t begin, std::int64_t end, const T* out_gradient,
                       const void* kept, const Gradients& gradients, void* memory) {
    char* at = static_cast<char*>(memory);
    Tile tile = lay_out(a, at);
    const int step = tile_queries(a), d = a.channels, rows = code_rows(a.components);
    for (std::int64_t query = begin; query < end; query += step) {
      const Element* exponentials = kept ? static_cast<const Element*>(kept) + query * pairs_per_query(a) * d : nullptr;
      prepare(a, query, int(end - query < step ? end - query : step), !kept, tile);
      soften_backward(a, tile, out_gradient + query * d, exponentials);
      auto columns = [&](const Element* x, int i) {
        return Format::columns(x, tile.pairs, d, tile.ld, tile.columns[i]);
      };
      if (gradients.mix)
        Format::product_of_columns(d, d, tile.pairs, columns(tile.logit_gradient, 0), columns(tile.hidden, 1),
                                   Add<S>{gradients.mix, d});
      Format::product_of_rows(tile.pairs, d, d, tile.logit_gradient, tile.ld, a.mix, tile.ld, HiddenGradient{tile});
      const Element* code = nullptr;
      if constexpr (Format::half)
        code = tile.code_copy;
      else
        code = tile.code;
      if (gradients.logit_code)
        Format::product_with_columns(rows, d, tile.pairs, code, tile.code_stride, columns(hidden_gradient(tile), 0),
                                     Add<S>{gradients.logit_code, d});
      if (gradients.value_code)
        Format::product_with_columns(rows, d, tile.pairs, code, tile.code_stride, columns(value_gradient(tile), 1),
                                     Add<S>{gradients.value_code, d});
      scatter(a, query, tile, gradients);
      if (gradients.query_position || gradients.key_position) position_gradients(a, query, tile, gradients);
    }
  }

  static constexpr AttentionKernels<T> kernels{workspace, forward, backward, tile_queries, sizeof(Element)};
};

}  // namespace
}  // namespace moomill
