#include "neural/checkpoint.h"

#include <cstring>
#include <set>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

constexpr std::string_view magic = "moomill netepu tensors 1\n";

struct TypeRow {
  torch::ScalarType type;
  const char* name;
};
constexpr TypeRow types[] = {{torch::kFloat, "float32"}, {torch::kHalf, "float16"}, {torch::kLong, "int64"}};

const char* name_of(torch::ScalarType type) {
  for (const TypeRow& row : types)
    if (row.type == type) return row.name;
  check(false, "tensor files hold float32, float16 and int64");
  return "";
}

}  // namespace

// Of everything in a file's header but this hash itself; the body has its own.
static std::string header_hash(const nlohmann::json& all) {
  const std::string text = all.dump();
  return xxh64_hex(text.data(), text.size());
}

void write_tensor_file(const std::filesystem::path& file, const TensorFile& contents) {
  nlohmann::json index = nlohmann::json::object();
  std::size_t bytes = 0;
  for (const auto& [name, tensor] : contents.tensors) {
    index[name] = {{"shape", tensor.sizes().vec()}, {"type", name_of(tensor.scalar_type())}, {"offset", bytes}};
    bytes += tensor.nbytes();
  }
  std::string body;
  body.reserve(bytes);
  for (const auto& [name, tensor] : contents.tensors) {
    const torch::Tensor plain = tensor.detach().cpu().contiguous();
    body.append(static_cast<const char*>(plain.data_ptr()), plain.nbytes());
  }
  nlohmann::json all{{"header", contents.header},
                     {"tensors", index},
                     {"bytes", bytes},
                     {"xxh64", xxh64_hex(body.data(), body.size())}};
  all["header_xxh64"] = header_hash(all);
  const std::string header = all.dump();
  const std::uint64_t size = header.size();
  std::string text(magic);
  text.append(reinterpret_cast<const char*>(&size), sizeof size);
  text += header + body;
  write_file_atomically(file, text);
}

TensorFile read_tensor_file(const std::filesystem::path& file) {
  const std::vector<std::uint8_t> data = read_file(file);
  const auto refuse = [&](const char* what) { input_error("{}: {}; train again, or name another file", file.string(), what); };
  std::uint64_t size = 0;
  const std::size_t start = magic.size() + sizeof size;
  if (data.size() < start || std::memcmp(data.data(), magic.data(), magic.size()) != 0) refuse("is no model of netepu");
  std::memcpy(&size, data.data() + magic.size(), sizeof size);
  if (size > data.size() - start) refuse("is cut short");
  TensorFile contents;
  try {
    const char* text = reinterpret_cast<const char*>(data.data()) + start;
    nlohmann::json all = nlohmann::json::parse(text, text + size);
    const std::string written_hash = all.at("header_xxh64");
    all.erase("header_xxh64");
    if (header_hash(all) != written_hash) refuse("is damaged (the hash of its header does not match)");
    const std::size_t bytes = all.at("bytes");
    const std::uint8_t* body = data.data() + start + size;
    if (data.size() - start - size < bytes) refuse("is cut short");
    if (xxh64_hex(body, bytes) != all.at("xxh64").get<std::string>()) refuse("is damaged (its hash does not match)");
    contents.header = all.at("header");
    for (const auto& [name, entry] : all.at("tensors").items()) {
      const auto shape = entry.at("shape").get<std::vector<std::int64_t>>();
      const std::string type_name = entry.at("type");
      const std::size_t offset = entry.at("offset");
      const TypeRow* type = nullptr;
      for (const TypeRow& row : types)
        if (type_name == row.name) type = &row;
      if (!type) refuse("holds a tensor of an unknown type");
      for (const std::int64_t extent : shape)
        if (extent < 0 || extent > std::int64_t{1} << 40) refuse("is damaged (a tensor's shape is out of range)");
      torch::Tensor tensor = torch::empty(shape, type->type);
      if (offset > bytes || tensor.nbytes() > bytes - offset) refuse("is damaged (a tensor lies outside it)");
      std::memcpy(tensor.data_ptr(), body + offset, tensor.nbytes());
      contents.tensors[name] = tensor;
    }
  } catch (const nlohmann::json::exception&) {
    refuse("is damaged (its header cannot be read)");
  }
  return contents;
}

void store_module(const torch::nn::Module& module, const std::string& prefix, bool half,
                  std::map<std::string, torch::Tensor>& tensors) {
  const auto store = [&](const std::string& name, const torch::Tensor& t) {
    tensors[prefix + name] = (half && t.is_floating_point() ? t.detach().to(torch::kHalf) : t.detach()).clone();
  };
  for (const auto& p : module.named_parameters()) store(p.key(), p.value());
  for (const auto& b : module.named_buffers()) store(b.key(), b.value());
}

void restore_module(torch::nn::Module& module, const std::string& prefix, const std::map<std::string, torch::Tensor>& tensors,
                    const std::string& file) {
  torch::NoGradGuard fixed;
  std::set<std::string> used;
  const auto restore = [&](const std::string& name, torch::Tensor t) {
    const auto found = tensors.find(prefix + name);
    if (found == tensors.end() || found->second.sizes() != t.sizes())
      input_error("{}: does not fit its configuration (tensor '{}'); it is of another configuration, train anew", file,
                  prefix + name);
    t.copy_(found->second);
    used.insert(found->first);
  };
  for (const auto& p : module.named_parameters()) restore(p.key(), p.value());
  for (const auto& b : module.named_buffers()) restore(b.key(), b.value());
  for (const auto& [name, tensor] : tensors)
    if (name.starts_with(prefix) && !used.contains(name))
      input_error("{}: its configuration has no place for tensor '{}'; it is of another configuration, train anew", file, name);
}

void save_model(const std::filesystem::path& file, const Model& model, bool half) {
  TensorFile contents;
  contents.header = {{"kind", "model"},
                     {"version", MOOMILL_VERSION},
                     {"config", to_json(model.config)},
                     {"coats", model.coat_names},
                     {"provenance", model.provenance},
                     {"texture", !model.texture.is_empty()}};
  store_module(*model.geometry, "geometry.", half, contents.tensors);
  if (!model.texture.is_empty()) store_module(*model.texture, "texture.", half, contents.tensors);
  write_tensor_file(file, contents);
}

Model load_model(const std::filesystem::path& file) {
  const TensorFile contents = read_tensor_file(file);
  Model model;
  try {
    if (contents.header.at("kind") != "model")
      input_error("{}: is a training state, not a model; name the model.netepu beside it", file.string());
    model.config = config_from_json(contents.header.at("config"), file.string());
    model.coat_names = contents.header.at("coats").get<std::vector<std::string>>();
    model.provenance = contents.header.at("provenance");
    model.geometry = GeometryNetwork(model.config.model);
    restore_module(*model.geometry, "geometry.", contents.tensors, file.string());
    model.geometry->eval();
    if (contents.header.at("texture").get<bool>()) {
      model.texture = TextureNetwork(model.config.model);
      restore_module(*model.texture, "texture.", contents.tensors, file.string());
      model.texture->eval();
    }
  } catch (const nlohmann::json::exception&) {
    input_error("{}: its header is not that of a model; train again, or name another file", file.string());
  }
  return model;
}

}  // namespace moomill
