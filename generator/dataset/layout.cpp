// Where every file of a dataset lies. The `nepumoo` layout: what the public NeTePu loader reads, and our files beside.
#include <algorithm>
#include <array>

#include "generator/core/error.h"
#include "generator/dataset/dataset.h"

namespace moomill {
namespace {

// Folders of the public loader, by coat index; the twelfth coat has a folder of its own.
constexpr std::array<const char*, 11> cow_coats = {"Cow_Holstein.tif",       "Cow_brown.png",     "Cow_brown2.png",
                                                   "Cow_freckles.png",       "Cow_freckles2.png", "Cow_holstein2.png",
                                                   "Cow_holstein3.png",      "Cow_holstein4.png", "Cow_holstein5.png",
                                                   "Cow_Limousine_Spec.tif", "Cow_white.png"};
constexpr int cow_limousine = 11;
constexpr const char* cow_new_cameras = "cow_animation_alltextures_10newcameras.blend";

bool is_cow(const Manifest& m) {
  return m.species == "cow";
}

// A coat may be named by the path of an image; a folder may not.
std::string plain_name(std::string name) {
  std::replace_if(
      name.begin(), name.end(), [](char c) { return c == '/' || c == '\\' || c == '{' || c == '}' || c == ':'; }, '_');
  return name.empty() || name.front() == '.' ? "coat" + name : name;
}

bool is_individual(const Manifest& m, int coat) {
  return coat >= 0 && coat < static_cast<int>(m.individuals.size()) && m.individuals[coat];
}

// Individuals of a breed have folders of their own name, whatever their index: the public loader knows none of them.
std::string coat_name(const Manifest& m, int coat) {
  if (is_cow(m) && !is_individual(m, coat) && coat >= 0 && coat < static_cast<int>(cow_coats.size())) return cow_coats[coat];
  if (coat >= 0 && coat < static_cast<int>(m.coats.size())) return plain_name(m.coats[coat]);
  return fmt::format("coat{}", std::max(coat, 0));
}

std::string occlusions_folder(const Manifest& m) {
  return m.species + "_occlusions";
}

// Where our own modalities lie. Each subset has a place of its own, so that all three fit under one root.
std::string own_folder(const Manifest& m, const char* modality) {
  switch (m.subset) {
    case Subset::main:
      return modality;
    case Subset::novel_views:
      return fmt::format("{}/{}", is_cow(m) ? cow_new_cameras : m.species + "_animation_alltextures_newcameras",
                         modality);
    case Subset::occlusions:
      return fmt::format("{}/{}", occlusions_folder(m), modality);
  }
  return modality;
}

std::string nnopcs_folder(const Manifest& m) {
  switch (m.subset) {
    case Subset::main:
      return m.species + "_positional_encoding";
    case Subset::novel_views:
      return is_cow(m) ? "cow_animation_positional_encoding_10newcameras.blend"
                       : m.species + "_animation_positional_encoding_newcameras";
    // The loader takes the unoccluded maps of the main set there; this is the visible part.
    case Subset::occlusions:
      return occlusions_folder(m) + "/positional_encoding";
  }
  return {};
}

// Masks and depth are read from the first coat's folder only.
std::string geometry_folder(const Manifest& m) {
  return coat_folder(m, 0);
}

}  // namespace

std::string coat_folder(const Manifest& m, int coat) {
  if (m.subset == Subset::occlusions)  // one composite picture per view, whatever the coats in it
    return m.coat_indices.size() > 1 ? occlusions_folder(m) + "/" + coat_name(m, coat) : occlusions_folder(m);
  const bool novel = m.subset == Subset::novel_views;
  if (is_cow(m)) {
    const bool limousine = coat == cow_limousine && !is_individual(m, coat);
    if (novel)
      return fmt::format("{}/{}", cow_new_cameras, limousine ? "Cow_Limousine.tif" : coat_name(m, coat));
    if (limousine) return "cow_animation_Limousine.blend";
    return "cow_animation_alltextures.blend/" + coat_name(m, coat);
  }
  return fmt::format("{}_animation_alltextures{}/{}", m.species, novel ? "_newcameras" : "", coat_name(m, coat));
}

std::string path_template(const Manifest& m, Modality modality, int coat, int animal) {
  const ModalityRow& r = row(modality);
  const std::string camera = "/{camera:03}/", tail = "{frame:04}.{camera:03}";
  switch (modality) {
    case Modality::rgb:
      return coat_folder(m, coat) + camera + "Image" + tail + ".jpg";
    case Modality::silhouette:
      return geometry_folder(m) + camera + "objectID" + tail + ".png";
    case Modality::depth:
      return geometry_folder(m) + camera + "depth" + tail + ".exr";
    case Modality::nnopcs:
      return nnopcs_folder(m) + camera + "nnopcs" + tail + ".exr";
    case Modality::occlusion:
      if (m.subset == Subset::occlusions && animal == labelled_animal)
        return geometry_folder(m) + camera + "objectID_complete_mask_" + tail + ".png";
      if (m.animals.size() > 1)  // whole masks overlap, so each animal has a file
        return own_folder(m, r.name) + camera + r.name + tail + fmt::format(".animal{}.png", animal);
      break;
    default:
      break;
  }
  return own_folder(m, r.name) + camera + r.name + tail + extension(r.storage);
}

std::string nnopcs8_template(const Manifest& m) {
  return nnopcs_folder(m) + "/{camera:03}/Image{frame:04}.{camera:03}.png";
}

std::string record_template() {
  return "frames/{frame:04}.json";
}

std::string keypoints_csv_path(const Manifest& m) {
  return geometry_folder(m) + "/keypoints.csv";
}

std::string parameters_cfg_path(const Manifest& m) {
  return geometry_folder(m) + "/parameters.cfg";
}

std::string rig_path(const Manifest& m, int animal) {
  if (animal >= 0 && animal < static_cast<int>(m.rig_files.size())) return m.rig_files[animal];
  return fmt::format("rigs/{}.glb", animal);
}

std::string expand_template(const std::string& path, int frame, int camera) {
  std::string out;
  out.reserve(path.size());
  for (std::size_t i = 0; i < path.size();) {
    if (path.compare(i, 10, "{frame:04}") == 0) {
      out += fmt::format("{:04}", frame);
      i += 10;
    } else if (path.compare(i, 11, "{camera:03}") == 0) {
      out += fmt::format("{:03}", camera);
      i += 11;
    } else {
      out += path[i++];
    }
  }
  return out;
}

std::filesystem::path file_of(const Manifest& m, Modality modality, int frame, int camera, int coat, int animal) {
  return expand_template(path_template(m, modality, coat, animal), frame, camera);
}

std::vector<std::string> exr_channel_names(Modality modality) {
  switch (modality) {
    case Modality::uv:
      return {"u", "v"};
    case Modality::triangle:
      return {"id", "u", "v"};
    default:
      return {"R", "G", "B"};  // depth too: a one-channel file breaks the public loader
  }
}

}  // namespace moomill
