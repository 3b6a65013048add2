#pragma once
// JSON of the dataset's values, shared by manifest, records and readers.
#include <filesystem>

#include "generator/dataset/dataset.h"

namespace moomill {

// Sorted keys; objects spread over lines, arrays of plain values on one line; ends with a newline.
std::string dump_json(const Json& json);
Json parse_json_file(const std::filesystem::path& file);  // InputError names file and place
Json parse_json(const std::string& text, const std::string& file);

// What is wrong, without the library's number of it.
std::string reason_of(const Json::exception& error);

Json camera_to_json(const CameraRecord& camera);
CameraRecord camera_from_json(const Json& json);

Json vector_to_json(const dvec3& v);
dvec3 vector_from_json(const Json& json);
Json matrix_to_json(const dmat4& m);  // 3x4, row-major
dmat4 matrix_from_json(const Json& json);
double number_from_json(const Json& json);  // null is NaN

}  // namespace moomill
