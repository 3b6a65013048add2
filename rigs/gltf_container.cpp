#include "rigs/gltf_container.h"

#include <cstring>
#include <fstream>

#include "generator/core/error.h"

namespace moomill::gltf {
namespace {

using nlohmann::json;

constexpr int deepest_json = 100;  // parsers recurse; no real file nests deeper than a dozen levels

std::uint32_t little_endian(const std::uint8_t* p) {
  return p[0] | p[1] << 8 | p[2] << 16 | static_cast<std::uint32_t>(p[3]) << 24;
}

struct Chunks {
  const std::uint8_t *text = nullptr, *binary = nullptr;
  std::size_t text_size = 0, binary_size = 0;
};

Chunks split_glb(const std::vector<std::uint8_t>& bytes, const std::string& file) {
  if (bytes.size() < 20)
    input_error("{}: the file ends within the .glb header ({} bytes), copy or export it again", file, bytes.size());
  const std::uint32_t version = little_endian(&bytes[4]);
  if (version != 2) input_error("{}: .glb version {} is not supported, export it as glTF 2.0", file, version);
  const std::size_t total = little_endian(&bytes[8]);
  if (total > bytes.size())
    input_error("{}: the file is cut short, {} of {} bytes are there, copy or export it again", file, bytes.size(),
                total);
  Chunks chunks;
  std::size_t at = 12;
  for (int index = 0; at + 8 <= total; ++index) {
    const std::size_t size = little_endian(&bytes[at]);
    const std::uint32_t type = little_endian(&bytes[at + 4]);
    at += 8;
    if (size > total - at)
      input_error("{}: chunk {} of the .glb has {} bytes but only {} are left, export it again", file, index, size,
                  total - at);
    if (index == 0 && type != 0x4E4F534A)
      input_error("{}: the first chunk of the .glb is not JSON, export it again", file);
    if (index == 0) chunks.text = &bytes[at], chunks.text_size = size;
    if (index == 1 && type == 0x004E4942) chunks.binary = bytes.data() + at, chunks.binary_size = size;
    at += size;
  }
  return chunks;
}

json parse_json(const std::uint8_t* text, std::size_t size, const std::string& file) {
  bool too_deep = false;
  const auto watch_depth = [&](int depth, json::parse_event_t, json&) {
    too_deep |= depth > deepest_json;
    return !too_deep;
  };
  json document;
  try {
    document = json::parse(text, text + size, watch_depth);
  } catch (const json::exception& e) {
    if (!too_deep) {
      std::string why = e.what();
      if (const auto bracket = why.find("] "); bracket != std::string::npos) why = why.substr(bracket + 2);
      input_error("{}: its JSON cannot be read ({}), export it again", file, why);
    }
  }
  if (too_deep) input_error("{}: its JSON nests deeper than {} levels, export it again", file, deepest_json);
  if (!document.is_object()) input_error("{}: its JSON is not an object, so this is not a glTF file", file);
  return document;
}

const json& array_of(const json& document, const char* name) {
  static const json none = json::array();
  const auto it = document.find(name);
  return it != document.end() && it->is_array() ? *it : none;
}

std::string string_of(const json& object, const char* name) {
  if (!object.is_object()) return {};
  const auto it = object.find(name);
  return it != object.end() && it->is_string() ? it->get<std::string>() : std::string();
}

bool extension_is_supported(const std::string& name) {
  // Material and light extensions change the look only, which coats and scenes decide here.
  return name == "KHR_texture_transform" || name == "KHR_mesh_quantization" || name == "KHR_lights_punctual" ||
         name.starts_with("KHR_materials_");
}

void check_version(const json& document, const std::string& file) {
  const json asset = document.value("asset", json::object());
  const std::string version = string_of(asset, "version");
  if (version.empty()) input_error("{}: asset.version is missing, so this is not a glTF file", file);
  if (!version.starts_with("2."))
    input_error("{}: glTF version {} is not supported, export it as glTF 2.0", file, version);
  if (const std::string least = string_of(asset, "minVersion"); !least.empty() && least != "2.0")
    input_error("{}: asks for glTF {} or later, export it as glTF 2.0", file, least);
  for (const json& extension : array_of(document, "extensionsRequired")) {
    const std::string name = extension.is_string() ? extension.get<std::string>() : "(not a name)";
    if (!extension_is_supported(name))
      input_error("{}: requires the extension {}, which moomill does not support, export it without", file, name);
  }
}

// Empty where the text is not base64.
std::vector<std::uint8_t> decode_base64(std::string_view text) {
  std::vector<std::uint8_t> bytes;
  bytes.reserve(text.size() / 4 * 3);
  std::uint32_t pending = 0;
  int bits = 0;
  for (const char c : text) {
    int value = -1;
    if (c >= 'A' && c <= 'Z') value = c - 'A';
    if (c >= 'a' && c <= 'z') value = c - 'a' + 26;
    if (c >= '0' && c <= '9') value = c - '0' + 52;
    if (c == '+' || c == '-') value = 62;
    if (c == '/' || c == '_') value = 63;
    if (c == '=') break;
    if (value < 0) return {};
    pending = (pending << 6 | static_cast<std::uint32_t>(value)) & 0xFFFFFF;
    bits += 6;
    if (bits >= 8) {
      bits -= 8;
      bytes.push_back(static_cast<std::uint8_t>(pending >> bits));
    }
  }
  return bytes;
}

std::vector<std::uint8_t> decode_data_uri(const std::string& uri) {
  const auto comma = uri.find(',');
  if (comma == std::string::npos) return {};
  const std::string_view head(uri.data(), comma), body(uri.data() + comma + 1, uri.size() - comma - 1);
  if (head.ends_with(";base64")) return decode_base64(body);
  const std::string plain = decode_uri(std::string(body));
  return {plain.begin(), plain.end()};
}

bool is_data_uri(const std::string& uri) {
  return uri.starts_with("data:");
}

}  // namespace

std::string decode_uri(const std::string& uri) {
  const auto digit = [](char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
  };
  std::string plain;
  for (std::size_t i = 0; i < uri.size(); ++i) {
    if (uri[i] == '%' && i + 2 < uri.size() && digit(uri[i + 1]) >= 0 && digit(uri[i + 2]) >= 0) {
      plain += static_cast<char>(digit(uri[i + 1]) * 16 + digit(uri[i + 2]));
      i += 2;
    } else {
      plain += uri[i];
    }
  }
  return plain;
}

std::vector<std::uint8_t> read_bytes(const std::filesystem::path& file) {
  std::error_code error;
  if (std::filesystem::is_directory(file, error))
    input_error("{}: is a folder, name the model file in it", file.string());
  if (std::filesystem::exists(file, error) && !std::filesystem::is_regular_file(file, error))
    input_error("{}: is not a regular file", file.string());
  std::ifstream in(file, std::ios::binary | std::ios::ate);
  if (!in || in.tellg() < 0) input_error("{}: cannot be opened, check the path", file.string());
  std::vector<std::uint8_t> bytes(static_cast<std::size_t>(in.tellg()));
  in.seekg(0);
  if (!bytes.empty() && !in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size())))
    input_error("{}: cannot be read to its end", file.string());
  return bytes;
}

Container open_container(const std::filesystem::path& path) {
  const std::string file = path.string();
  const std::vector<std::uint8_t> bytes = read_bytes(path);
  Chunks chunks{bytes.data(), nullptr, bytes.size(), 0};
  if (bytes.size() >= 4 && std::memcmp(bytes.data(), "glTF", 4) == 0) chunks = split_glb(bytes, file);

  Container container;
  container.json = parse_json(chunks.text, chunks.text_size, file);
  check_version(container.json, file);

  const json& buffers = array_of(container.json, "buffers");
  for (std::size_t i = 0; i < buffers.size(); ++i) {
    const json& buffer = buffers[i];
    if (!buffer.is_object() || !buffer.contains("byteLength") || !buffer["byteLength"].is_number_unsigned())
      input_error("{}: buffers[{}].byteLength is missing or not a number, export it again", file, i);
    const std::uint64_t wanted = buffer["byteLength"].get<std::uint64_t>();
    const std::string uri = string_of(buffer, "uri");
    std::vector<std::uint8_t> data;
    std::string where = "the .glb";
    if (uri.empty()) {
      if (!chunks.binary || i != 0)
        input_error("{}: buffers[{}] names no file and the .glb has no data for it, export it again", file, i);
      data.assign(chunks.binary, chunks.binary + chunks.binary_size);
    } else if (is_data_uri(uri)) {
      data = decode_data_uri(uri);
      where = "its data URI";
    } else {
      const std::filesystem::path source = path.parent_path() / decode_uri(uri);
      std::error_code error;
      if (!std::filesystem::is_regular_file(source, error))
        input_error("{}: buffers[{}] is in '{}', which is not there, put it beside the model", file, i,
                    decode_uri(uri));
      data = read_bytes(source);
      where = "'" + decode_uri(uri) + "'";
    }
    if (wanted == 0 || wanted > data.size())
      input_error("{}: buffers[{}] should have {} bytes but {} has {}, export it again", file, i, wanted, where,
                  data.size());
    data.resize(wanted);
    container.buffers.push_back(std::move(data));
  }

  const json& images = array_of(container.json, "images");
  for (std::size_t i = 0; i < images.size(); ++i) {
    EncodedImage image;
    const std::string uri = string_of(images[i], "uri");
    image.name = string_of(images[i], "name");
    if (is_data_uri(uri)) {
      image.bytes = decode_data_uri(uri);
    } else if (!uri.empty()) {
      if (image.name.empty()) image.name = decode_uri(uri);
      const std::filesystem::path source = path.parent_path() / decode_uri(uri);
      std::error_code error;
      if (std::filesystem::is_regular_file(source, error))
        image.bytes = read_bytes(source);
      else
        container.warnings.push_back(
            fmt::format("texture '{}' is not there, its material goes without", decode_uri(uri)));
    }
    if (image.name.empty()) image.name = fmt::format("image {}", i);
    container.images.push_back(std::move(image));
  }
  return container;
}

}  // namespace moomill::gltf
