#include <fcntl.h>
#include <sys/resource.h>

#include <csignal>
#include <fstream>

#include "generator/dataset/encode_view.h"
#include "tests/dataset/helpers.h"

using namespace moomill;
using namespace moomill::test;

namespace {

void store(const fs::path& file, const std::vector<std::uint8_t>& bytes) {
  write_file_atomically(file, bytes.data(), bytes.size());
}

Image8 noise8(int w, int h, int c) {
  Image8 image(w, h, c);
  for (std::size_t i = 0; i < image.data.size(); ++i)
    image.data[i] = static_cast<std::uint8_t>(hash(static_cast<std::uint32_t>(i)));
  return image;
}

}  // namespace

TEST_CASE("PNG reads back, by libpng and by OpenImageIO") {
  TemporaryFolder folder;
  for (int channels : {1, 3, 4})
    for (auto [w, h] : {std::pair{1, 1}, {17, 5}, {1, 40}, {64, 33}}) {
      const Image8 image = noise8(w, h, channels);
      store(folder / "a.png", encode_png8(image));
      for (const Image8& back : {decode_png8(folder / "a.png"), read_image8(folder / "a.png")}) {
        CHECK(back.width == w);
        CHECK(back.height == h);
        CHECK(back.channels == channels);
        CHECK(back.data == image.data);
      }
    }
  Image<std::uint16_t> labels(19, 7, 1);
  for (std::size_t i = 0; i < labels.data.size(); ++i) labels.data[i] = static_cast<std::uint16_t>(i * 499);
  store(folder / "b.png", encode_png16(labels));
  CHECK(decode_png16(folder / "b.png").data == labels.data);
  CHECK(message_of<InputError>([&] { decode_png8(folder / "b.png"); }).find("b.png") != std::string::npos);
  CHECK_THROWS_AS(decode_png16(folder / "a.png"), InputError);
}

TEST_CASE("JPEG reads back closely, without chroma subsampling") {
  TemporaryFolder folder;
  Image8 image(40, 24, 3);
  for (int y = 0; y < 24; ++y)
    for (int x = 0; x < 40; ++x) {
      image.at(x, y, 0) = x < 20 ? 255 : 0;  // a sharp edge in colour alone
      image.at(x, y, 2) = x < 20 ? 0 : 255;
    }
  store(folder / "a.jpg", encode_jpeg(image));
  const Image8 back = decode_jpeg(folder / "a.jpg");
  REQUIRE(back.data.size() == image.data.size());
  int worst = 0;
  for (std::size_t i = 0; i < image.data.size(); ++i) worst = std::max(worst, std::abs(back.data[i] - image.data[i]));
  CHECK(worst < 24);
  CHECK(read_image8(folder / "a.jpg").width == 40);
}

TEST_CASE("EXR reads back bit for bit, by OpenEXR and by OpenImageIO") {
  TemporaryFolder folder;
  for (auto [w, h] : {std::pair{1, 1}, {3, 16}, {31, 37}, {8, 64}}) {
    ImageF image(w, h, 3);
    std::vector<std::uint32_t> ids(static_cast<std::size_t>(w) * h);
    for (std::size_t i = 0; i < image.data.size(); ++i)
      image.data[i] = i % 3 ? static_cast<float>(hash(static_cast<std::uint32_t>(i))) * 1e-3f : -0.0f;
    for (std::size_t i = 0; i < ids.size(); ++i) ids[i] = hash(static_cast<std::uint32_t>(i)) | 0x80000000u;
    const std::vector<ExrChannel> channels = {{"R", image.data.data(), nullptr, 3},
                                              {"G", image.data.data() + 1, nullptr, 3},
                                              {"B", image.data.data() + 2, nullptr, 3},
                                              {"id", nullptr, ids.data(), 1}};
    store(folder / "a.exr", encode_exr(w, h, channels));
    const ExrImage back = decode_exr(folder / "a.exr");
    REQUIRE(back.width == w);
    REQUIRE(back.height == h);
    CHECK(back.ids[back.channel("id")] == ids);
    CHECK(back.channel("Z") == -1);
    for (int c = 0; c < 3; ++c)
      for (std::size_t i = 0; i < ids.size(); ++i)
        CHECK(std::bit_cast<std::uint32_t>(back.data[back.channel(std::string(1, "RGB"[c]))][i]) ==
              std::bit_cast<std::uint32_t>(image.data[3 * i + c]));
    store(folder / "rgb.exr", encode_exr(w, h, {channels[0], channels[1], channels[2]}));
    CHECK(read_imagef(folder / "rgb.exr").data == image.data);
  }
}

TEST_CASE("an EXR of blank blocks among others") {
  TemporaryFolder folder;
  ImageF image(50, 100, 1);
  image.at(7, 40) = 3;
  store(folder / "a.exr", encode_exr(50, 100, {{"Y", image.data.data(), nullptr, 1}}));
  CHECK(decode_exr(folder / "a.exr").data[0] == image.data);
}

TEST_CASE("encoders are deterministic") {
  const Image8 image = noise8(50, 40, 3);
  CHECK(encode_png8(image) == encode_png8(image));
  CHECK(encode_jpeg(image) == encode_jpeg(image));
  const ImageF f(50, 40, 1, 0.3f);
  CHECK(encode_exr(50, 40, {{"Y", f.data.data(), nullptr, 1}}) ==
        encode_exr(50, 40, {{"Y", f.data.data(), nullptr, 1}}));
}

TEST_CASE("depth written as three planes costs little more than one") {
  ImageF depth(256, 256, 1);
  for (int y = 40; y < 200; ++y)
    for (int x = 60; x < 190; ++x) depth.at(x, y) = 7.0f + 0.3f * std::sin(0.05f * x) * std::cos(0.03f * y);
  Map map;
  map.modality = Modality::depth;
  map.f = depth;
  const std::size_t three = encode_map_exr(map).size();
  const std::size_t one = encode_exr(256, 256, {{"Z", depth.data.data(), nullptr, 1}}).size();
  CHECK(three < one + one / 4);
}

TEST_CASE("every reader names the file that is missing, empty, cut short or garbage") {
  TemporaryFolder folder;
  const Image8 image = noise8(64, 64, 3);
  const ImageF f(64, 64, 1, 0.5f);
  store(folder / "good.png", encode_png8(image));
  store(folder / "good.jpg", encode_jpeg(image));
  std::vector<float> random(64 * 64);
  for (std::size_t i = 0; i < random.size(); ++i) random[i] = static_cast<float>(hash(static_cast<std::uint32_t>(i)));
  store(folder / "good.exr", encode_exr(64, 64, {{"Y", random.data(), nullptr, 1}}));
  Image<std::uint16_t> labels(64, 64, 1, 300);
  store(folder / "good16.png", encode_png16(labels));

  using Reader = std::function<void(const fs::path&)>;
  const std::vector<std::pair<std::string, Reader>> readers = {
      {"good.png", [](const fs::path& p) { decode_png8(p); }},
      {"good16.png", [](const fs::path& p) { decode_png16(p); }},
      {"good.jpg", [](const fs::path& p) { decode_jpeg(p); }},
      {"good.exr", [](const fs::path& p) { decode_exr(p); }},
      {"good.png", [](const fs::path& p) { read_image8(p); }},
      {"good.jpg", [](const fs::path& p) { read_image8(p); }},
      {"good.exr", [](const fs::path& p) { read_imagef(p); }},
  };
  for (const auto& [good, reader] : readers) {
    CHECK_NOTHROW(reader(folder / good));
    const auto bytes = read_file(folder / good);
    const std::string extension = fs::path(good).extension();
    const auto refused = [&](const std::string& name, const std::vector<std::uint8_t>& content) {
      const fs::path file = folder / (name + extension);
      store(file, content);
      CHECK_MESSAGE(message_of<InputError>([&] { reader(file); }).find(file.string()) == 0, file.string());
    };
    CHECK(message_of<InputError>([&] { reader(folder / "absent.png"); }).find("absent.png") != std::string::npos);
    CHECK_THROWS_AS(reader(folder.path), InputError);
    refused("empty", {});
    refused("garbage", std::vector<std::uint8_t>(500, 0x5a));
    std::vector<std::uint8_t> random_bytes(3000);
    for (std::size_t i = 0; i < random_bytes.size(); ++i)
      random_bytes[i] = static_cast<std::uint8_t>(hash(static_cast<std::uint32_t>(i)));
    refused("random", random_bytes);
    for (double share : {0.02, 0.3, 0.7})
      refused("cut", {bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(bytes.size() * share)});
  }
  // A PNG with a wrong checksum.
  auto bytes = read_file(folder / "good.png");
  bytes[bytes.size() / 2] ^= 0x10;
  store(folder / "flipped.png", bytes);
  CHECK_THROWS_AS(decode_png8(folder / "flipped.png"), InputError);
}

TEST_CASE("any flipped byte in an EXR or PNG header is refused or read, never a crash") {
  TemporaryFolder folder;
  const ImageF f(8, 20, 1, 0.5f);
  const auto exr = encode_exr(8, 20, {{"Y", f.data.data(), nullptr, 1}});
  const auto png = encode_png8(noise8(8, 20, 3));
  int refused = 0;
  for (const auto* good : {&exr, &png})
    for (std::size_t i = 0; i < std::min<std::size_t>(good->size(), 400); ++i) {
      auto bytes = *good;
      bytes[i] ^= 0xff;
      const fs::path file = folder / (good == &exr ? "a.exr" : "a.png");
      store(file, bytes);
      try {
        good == &exr ? (void)decode_exr(file) : (void)decode_png8(file);
      } catch (const InputError&) {
        ++refused;
      }
    }
  CHECK(refused > 100);
}

TEST_CASE("light must be finite") {
  TemporaryFolder folder;
  ImageF image(4, 3, 3, 1.0f);
  image.at(2, 1, 1) = std::numeric_limits<float>::quiet_NaN();
  store(folder / "a.exr", encode_exr(4, 3,
                                     {{"R", image.data.data(), nullptr, 3},
                                      {"G", image.data.data() + 1, nullptr, 3},
                                      {"B", image.data.data() + 2, nullptr, 3}}));
  CHECK(message_of<InputError>([&] { read_imagef(folder / "a.exr"); }).find("pixel (2, 1)") != std::string::npos);
}

TEST_CASE("images come from memory whatever their name") {
  const Image8 image = noise8(20, 10, 3);
  CHECK(read_image8(encode_png8(image), "texture 3 of cow.glb").data == image.data);
  CHECK(read_image8(encode_jpeg(image), "texture.png").width == 20);
}

TEST_CASE("a full disk is told with its mend, and leaves nothing behind") {
  const int descriptor = ::open("/dev/full", O_WRONLY);
  REQUIRE(descriptor >= 0);
  const std::string message = message_of<RunError>([&] { write_all(descriptor, "out/frames/0001.json", "x", 1); });
  ::close(descriptor);
  CHECK(message.find("out/frames/0001.json") == 0);
  CHECK(message.find("No space left") != std::string::npos);

  // A limit on the file size stops the write in the middle, as a full disk would.
  TemporaryFolder folder;
  struct rlimit before {};
  getrlimit(RLIMIT_FSIZE, &before);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  struct rlimit small = before;
  small.rlim_cur = 1000;
  setrlimit(RLIMIT_FSIZE, &small);
  std::string error;
  try {
    write_file_atomically(folder / "big", std::string(5000, 'x'));
  } catch (const RunError& e) {
    error = e.what();
  }
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  CHECK(error.find("big: cannot be written") != std::string::npos);
  CHECK(fs::is_empty(folder));
}

TEST_CASE("files replace others whole, and folders are made") {
  TemporaryFolder folder;
  write_file_atomically(folder / "a/b/c.txt", std::string("one"));
  write_file_atomically(folder / "a/b/c.txt", std::string("two"));
  const auto bytes = read_file(folder / "a/b/c.txt");
  CHECK(std::string(bytes.begin(), bytes.end()) == "two");
  CHECK_THROWS_AS(write_file_atomically(folder / "a/b/c.txt/d", std::string("x")), RunError);
  CHECK_THROWS_AS(make_file_atomically(folder / "e", [](const fs::path&) { throw RunError("no"); }), RunError);
  CHECK(xxh64_hex("", 0) == "ef46db3751d8e999");
}

TEST_CASE("colour is sRGB over the background, rounded to nearest") {
  ImageF rgba(4, 1, 4);
  const float values[4] = {0.0f, 0.5f, 1.0f, 7.0f};
  for (int x = 0; x < 4; ++x) {
    for (int c = 0; c < 3; ++c) rgba.at(x, 0, c) = values[x];
    rgba.at(x, 0, 3) = 1;
  }
  const Image8 out = to_srgb8(rgba, vec3(0));
  CHECK(out.at(0, 0) == 0);
  CHECK(out.at(1, 0) == 188);  // 0.7353... * 255 = 187.5
  CHECK(out.at(2, 0) == 255);
  CHECK(out.at(3, 0) == 255);
  // The table agrees with the formula for every code and close to every threshold.
  for (int i = 0; i <= 200000; ++i) {
    const float v = static_cast<float>(i) / 200000;
    ImageF one(1, 1, 3, v);
    const float s = v <= 0.0031308f ? 12.92f * v : 1.055f * std::pow(v, 1.0f / 2.4f) - 0.055f;
    REQUIRE(to_srgb8(one, vec3(0)).at(0, 0) == static_cast<int>(std::min(s * 255.0f + 0.5f, 255.0f)));
  }
  ImageF clear(1, 1, 4);
  CHECK(to_srgb8(clear, vec3(1, 0, 0.5f)).data == std::vector<std::uint8_t>{255, 0, 188});
  ImageF half(1, 1, 4, 0.5f);  // premultiplied white at alpha 0.5 over black
  CHECK(to_srgb8(half, vec3(0)).at(0, 0) == 188);
}

TEST_CASE("8-bit NNOPCS never has a 0 in the foreground and always 0 outside") {
  ImageF nnopcs(2, 1, 3);
  ImageU32 mask(2, 1, 1);
  mask.data = {255, 0};
  nnopcs.data = {0.0f, 0.001f, 1.0f, 0.7f, 0.7f, 0.7f};
  CHECK(nnopcs_to_8bit(nnopcs, mask).data == std::vector<std::uint8_t>{1, 1, 255, 0, 0, 0});
}
