#pragma once
// What surrounds a glTF scene: the .glb chunks, the JSON, buffers and images wherever they are. All of it is read and
// checked here, so that the parser behind gltf.cpp sees only well-formed JSON and never touches a file.
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "generator/core/image.h"

namespace moomill::gltf {

struct Container {
  nlohmann::json json;                             // the whole document
  std::vector<std::vector<std::uint8_t>> buffers;  // one per entry of json["buffers"], exactly byteLength bytes
  std::vector<EncodedImage> images;                // one per entry of json["images"]; no bytes where they are missing
  std::vector<std::string> warnings;
};

// Throws InputError: unreadable, truncated, not glTF 2.x, a required extension that is not supported, a missing buffer.
Container open_container(const std::filesystem::path& file);

// The whole file. Throws InputError.
std::vector<std::uint8_t> read_bytes(const std::filesystem::path& file);

// "%20" and friends.
std::string decode_uri(const std::string& uri);

}  // namespace moomill::gltf
