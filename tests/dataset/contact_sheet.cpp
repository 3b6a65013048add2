#include "generator/dataset/contact_sheet.h"

#include "generator/dataset/draw.h"
#include "tests/dataset/helpers.h"

using namespace moomill;
using namespace moomill::test;

TEST_CASE("contact sheets show every view and every modality") {
  TemporaryFolder folder;
  const Manifest m = small_manifest(2, 9);
  {
    DatasetWriter writer(folder, m, 1);
    for (int frame : m.frames) write_frame(writer, m, frame);
    writer.finish();
  }
  ContactSheetOptions options;
  options.thumbnail_width = 64;
  const Image8 sheet = contact_sheet(folder, options);
  CHECK(sheet.channels == 3);
  CHECK(sheet.width >= 8 * 12);  // thumbnails are never enlarged
  CHECK(sheet.height >= 2 * 20);
  const Image8 modalities = modality_sheet(folder, options);
  CHECK(modalities.height >= 3 * 20);
  options.frame = 2;
  CHECK(contact_sheet(folder, options).data != sheet.data);
  options.frame = 77;
  CHECK(message_of<InputError>([&] { contact_sheet(folder, options); }).find("no frame 77") != std::string::npos);
  options.frame = 1;
  options.coat = 5;
  CHECK_THROWS_AS(contact_sheet(folder, options), InputError);
  options.coat = 1;
  options.camera = 40;
  CHECK_THROWS_AS(modality_sheet(folder, options), InputError);
  CHECK_THROWS_AS(contact_sheet(folder / "nowhere"), InputError);
}

TEST_CASE("drawing is cut off at the border and survives what is not finite") {
  Image8 image(20, 10, 3);
  draw_line(image, {-1e9, -1e9}, {1e9, 1e9}, 2, {255, 255, 255});
  draw_disc(image, {std::nan(""), 3}, 4, {255, 0, 0});
  draw_ring(image, {19, 9}, 5, 1, {0, 255, 0});
  draw_text(image, -3, 6, "cow 0123 ?", 2, {0, 0, 255});
  CHECK(image.at(5, 5, 0) == 255);
  CHECK(scale_down(image, 1, 1).data.size() == 3);
}
