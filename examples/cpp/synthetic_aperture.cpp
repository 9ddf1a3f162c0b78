// Multiplicative synthetic aperture refocusing through a plane wall: a program that takes part in
// sabench, in C++17 without any library.
//
//   synthetic_aperture DATASET RESULT [k=3]
//
// It reads cameras.json and the uncompressed 16-bit TIFF images by itself, and writes volumes as
// .npy; docs/developing/participate.md is the contract. The algorithm is that of
// ../python/synthetic_aperture.py, line by line.

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <map>
#include <numeric>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

using Vec = std::array<double, 3>;

static Vec minus(const Vec& a, const Vec& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
static double dot(const Vec& a, const Vec& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static std::string read_file(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    if (!in) throw std::runtime_error("cannot read " + path);
    std::ostringstream out;
    out << in.rdbuf();
    return out.str();
}

// ---- JSON: objects, arrays, strings, numbers, words; as much as the file needs ------------------

struct Json {
    enum Kind { null, number, text, array, object } kind = null;
    double value = 0.0;
    std::string string;
    std::vector<Json> items;
    std::map<std::string, Json> members;

    const Json& operator[](const std::string& key) const {
        auto found = members.find(key);
        if (found == members.end()) throw std::runtime_error("JSON: no key " + key);
        return found->second;
    }
    bool has(const std::string& key) const { return members.count(key) > 0; }
    Vec vec() const { return {items.at(0).value, items.at(1).value, items.at(2).value}; }
};

class JsonReader {
 public:
    explicit JsonReader(const std::string& text) : text_(text) {}

    Json read() {
        switch (next()) {
            case '{':
                return object();
            case '[':
                return array();
            case '"': {
                Json made;
                made.kind = Json::text;
                made.string = string();
                return made;
            }
            default:
                return word();
        }
    }

 private:
    char next() {
        while (at_ < text_.size() && std::isspace(static_cast<unsigned char>(text_[at_]))) at_++;
        if (at_ >= text_.size()) throw std::runtime_error("JSON: the text ends too early");
        return text_[at_];
    }
    void take(char expected) {
        if (next() != expected) throw std::runtime_error(std::string("JSON: expected ") + expected);
        at_++;
    }
    bool more(char end) {  // after an element: whether a comma follows
        if (next() == ',') {
            at_++;
            return true;
        }
        take(end);
        return false;
    }
    Json object() {
        Json made;
        made.kind = Json::object;
        take('{');
        if (next() == '}') {
            at_++;
            return made;
        }
        do {
            next();
            std::string key = string();
            take(':');
            made.members[key] = read();
        } while (more('}'));
        return made;
    }
    Json array() {
        Json made;
        made.kind = Json::array;
        take('[');
        if (next() == ']') {
            at_++;
            return made;
        }
        do made.items.push_back(read());
        while (more(']'));
        return made;
    }
    std::string string() {  // escapes are kept as they are: no name that we look for has one
        take('"');
        std::string made;
        while (at_ < text_.size() && text_[at_] != '"') {
            if (text_[at_] == '\\') made += text_[at_++];
            if (at_ < text_.size()) made += text_[at_++];
        }
        take('"');
        return made;
    }
    Json word() {
        Json made;
        size_t end = text_.find_first_of(",]} \n\r\t", at_);
        std::string word = text_.substr(at_, end == std::string::npos ? end : end - at_);
        at_ += word.size();
        if (word == "null" || word == "true" || word == "false") return made;
        made.kind = Json::number;
        made.value = std::stod(word);
        return made;
    }

    const std::string text_;
    size_t at_ = 0;
};

static Json read_json(const std::string& path) { return JsonReader(read_file(path)).read(); }

// ---- images -------------------------------------------------------------------------------------

struct Image {
    int rows = 0, columns = 0;
    std::vector<double> values;
    double at(int row, int column) const { return values[size_t(row) * columns + column]; }
};

class Tiff {  // one page of uncompressed 16-bit grey values in strips
 public:
    explicit Tiff(const std::string& path) : path_(path), data_(read_file(path)) {
        if (data_.size() < 8) fail("it is too short");
        little_ = data_[0] == 'I';
        if (number(2, 2) != 42) fail("it is no TIFF");
    }
    Image read() {
        size_t directory = number(4, 4), count = number(directory, 2);
        for (size_t i = 0; i < count; i++) {
            size_t entry = directory + 2 + 12 * i, tag = number(entry, 2);
            tags_[int(tag)] = values(entry);
        }
        if (one(258, 1) != 16 || one(259, 1) != 1 || one(277, 1) != 1)
            fail("expected uncompressed 16-bit grey values");
        Image image;
        image.rows = int(one(257, 0));
        image.columns = int(one(256, 0));
        const auto &offsets = tags_[273], &sizes = tags_[279];
        for (size_t strip = 0; strip < offsets.size(); strip++)
            for (size_t byte = 0; byte + 1 < sizes.at(strip); byte += 2)
                image.values.push_back(double(number(offsets[strip] + byte, 2)));
        if (image.values.size() != size_t(image.rows) * image.columns)
            fail("expected as many values as pixels");
        return image;
    }

 private:
    size_t number(size_t at, int bytes) const {
        if (at + bytes > data_.size()) fail("it ends too early");
        size_t value = 0;
        for (int i = 0; i < bytes; i++)
            value |= size_t(uint8_t(data_[at + (little_ ? i : bytes - 1 - i)])) << (8 * i);
        return value;
    }
    std::vector<size_t> values(size_t entry) const {
        size_t kind = number(entry + 2, 2), count = number(entry + 4, 4);
        int bytes = kind == 3 ? 2 : kind == 4 ? 4 : 1;
        size_t at = count * bytes <= 4 ? entry + 8 : number(entry + 8, 4);
        std::vector<size_t> found;
        if (kind == 3 || kind == 4)
            for (size_t i = 0; i < count; i++) found.push_back(number(at + i * bytes, bytes));
        return found;
    }
    size_t one(int tag, size_t otherwise) const {
        auto found = tags_.find(tag);
        return found == tags_.end() || found->second.empty() ? otherwise : found->second[0];
    }
    [[noreturn]] void fail(const std::string& why) const {
        throw std::runtime_error(path_ + ": " + why);
    }

    std::string path_, data_;
    bool little_ = true;
    std::map<int, std::vector<size_t>> tags_;
};

// Normalise grey values by a bright particle's, after subtracting black: the 95th percentile of the
// pixels that exceed a tenth of the brightest.
static Image normalised(const std::string& path, double black) {
    Image image = Tiff(path).read();
    for (double& value : image.values) value = std::max(value - black, 0.0);
    double largest = *std::max_element(image.values.begin(), image.values.end());
    std::vector<double> lit;
    std::copy_if(image.values.begin(), image.values.end(), std::back_inserter(lit),
                 [&](double value) { return value > 0.1 * largest; });
    if (lit.empty()) return image;
    std::sort(lit.begin(), lit.end());
    double bright = std::max(lit[size_t(0.95 * double(lit.size() - 1))], 1.0);
    for (double& value : image.values) value /= bright;
    return image;
}

static double sample(const Image& image, double column, double row) {  // bilinear; 0 outside
    if (!(column >= 0 && row >= 0 && column < image.columns - 1 && row < image.rows - 1))
        return 0.0;
    int i = int(row), j = int(column);
    double a = row - i, b = column - j;
    return (1 - a) * ((1 - b) * image.at(i, j) + b * image.at(i, j + 1)) +
           a * ((1 - b) * image.at(i + 1, j) + b * image.at(i + 1, j + 1));
}

// ---- optics -------------------------------------------------------------------------------------

struct Wall {
    bool there = false;
    Vec point{}, normal{};
    std::vector<double> ratio,
        solid;  // indices over the smallest of them, air first; thicknesses of the solid layers
    double thickness = 0.0;

    explicit Wall(const Json& wall) {
        if (wall.kind == Json::null) return;
        if (wall.kind != Json::object || !wall.has("normal"))
            throw std::runtime_error("it needs one plane wall in front of all cameras");
        there = true;
        point = wall["point_mm"].vec();
        normal = wall["normal"].vec();
        ratio.push_back(wall["air_index"].value);
        for (const Json& layer : wall["layers"].items) {
            ratio.push_back(layer["index"].value);
            solid.push_back(layer["thickness_mm"].value);
        }
        ratio.push_back(wall["fluid_index"].value);
        double least = *std::min_element(ratio.begin(), ratio.end());
        for (double& n : ratio) n /= least;
        thickness = std::accumulate(solid.begin(), solid.end(), 0.0);
    }

    // Direction in which the light path to a point leaves the pinhole: Snell's law through all
    // layers, by Newton's iteration for the tangent t of the path in the rarest medium.
    Vec leaving(const Vec& pinhole, const Vec& to) const {
        Vec way = minus(to, pinhole);
        if (!there) return way;
        double along = dot(way, normal);
        Vec lateral{way[0] - along * normal[0], way[1] - along * normal[1],
                    way[2] - along * normal[2]};
        double radius = std::sqrt(dot(lateral, lateral));
        std::vector<double>& depth = depth_;
        depth.assign(1, dot(minus(point, pinhole), normal));
        depth.insert(depth.end(), solid.begin(), solid.end());
        depth.push_back(dot(minus(to, point), normal) - thickness);
        double paraxial = 0.0;
        for (size_t i = 0; i < depth.size(); i++) paraxial += depth[i] / ratio[i];
        double t = radius / paraxial;
        for (int step = 0; step < 8; step++) {
            double reach = 0.0, slope = 0.0;
            for (size_t i = 0; i < depth.size(); i++) {
                double r2 = ratio[i] * ratio[i], s = std::sqrt(r2 + (r2 - 1) * t * t);
                reach += depth[i] * t / s;
                slope += depth[i] * r2 / (s * s * s);
            }
            t += (radius - reach) / slope;
        }
        double r2 = ratio[0] * ratio[0],
               scale = t / std::sqrt(r2 + (r2 - 1) * t * t) / std::max(radius, 1e-300);
        return {normal[0] + scale * lateral[0], normal[1] + scale * lateral[1],
                normal[2] + scale * lateral[2]};
    }

 private:
    mutable std::vector<double> depth_;
};

struct Camera {
    std::string name;
    Vec center{};
    std::array<Vec, 3> rotation{};
    double focal = 0.0, column = 0.0, row = 0.0, k1 = 0.0, k2 = 0.0, k3 = 0.0, p1 = 0.0, p2 = 0.0;
    double about_x = 0.0, about_y = 0.0;  // of the sensor, rad

    explicit Camera(const Json& camera)
        : name(camera["name"].string), center(camera["center_mm"].vec()) {
        for (int i = 0; i < 3; i++) rotation[i] = camera["rotation"].items.at(i).vec();
        focal = camera["principal_distance_mm"].value / camera["pixel_mm"].value;
        column = camera["principal_point_px"].items.at(0).value;
        row = camera["principal_point_px"].items.at(1).value;
        const Json& d = camera["distortion"];
        k1 = d["k1"].value, k2 = d["k2"].value, k3 = d["k3"].value, p1 = d["p1"].value,
        p2 = d["p2"].value;
        if (camera.has("tilt_deg")) {
            about_x = camera["tilt_deg"].items.at(0).value * M_PI / 180;
            about_y = camera["tilt_deg"].items.at(1).value * M_PI / 180;
        }
    }

    std::array<double, 2> project(const Wall& wall, const Vec& point) const {  // column, row
        Vec way = wall.leaving(center, point);
        double depth = dot(rotation[2], way), x = dot(rotation[0], way) / depth,
               y = dot(rotation[1], way) / depth, s = x * x + y * y;
        double radial = 1 + s * (k1 + s * (k2 + s * k3));
        double u = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x),
               v = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y;
        double ca = std::cos(about_x), sa = std::sin(about_x), cb = std::cos(about_y),
               sb = std::sin(about_y), near = (u * sb - v * sa * cb) / (ca * cb) + 1;
        double right = (u * cb + v * sa * sb - ca * sb) / near + ca * sb,
               down = (v * ca + sa) / near - sa;
        return {right * focal + column, down * focal + row};
    }
};

struct Rig {
    std::vector<Camera> cameras;
    Wall wall;
    Vec low{}, voxel{};
    std::array<size_t, 3> shape{};  // z, y, x
    double black = 0.0;
    int frames = 0;

    explicit Rig(const Json& file)
        : wall(file["wall"]),
          low(file["grid"]["low_mm"].vec()),
          voxel(file["grid"]["voxel_mm"].vec()) {
        if (file.has("preprocessing") && !file["preprocessing"].items.empty())
            throw std::runtime_error("preprocessing: this program takes raw images only");
        for (const Json& camera : file["cameras"].items) cameras.emplace_back(camera);
        for (int i = 0; i < 3; i++) shape[i] = size_t(file["grid"]["shape"].items.at(i).value);
        black = file["sensor"]["black_dn"].value;
        frames = int(file["frames"].value);
    }
};

// Refocus: volume (z, y, x), the product of all cameras to the power 3 / N, thresholded in each plane
// at k standard deviations above its mean.
static std::vector<float> refocus(const Rig& rig, const std::vector<Image>& images, double k) {
    size_t plane_size = rig.shape[1] * rig.shape[2];
    std::vector<float> volume(rig.shape[0] * plane_size);
    std::vector<double> plane(plane_size);
    double power = std::min(1.0, 3.0 / double(images.size()));
    for (size_t z = 0; z < rig.shape[0]; z++) {
        for (size_t i = 0; i < plane_size; i++) {
            Vec point{rig.low[0] + rig.voxel[0] * double(i % rig.shape[2]),
                      rig.low[1] + rig.voxel[1] * double(i / rig.shape[2]),
                      rig.low[2] + rig.voxel[2] * double(z)};
            double product = 1.0;
            for (size_t c = 0; c < images.size(); c++) {
                auto pixel = rig.cameras[c].project(rig.wall, point);
                product *= std::max(sample(images[c], pixel[0], pixel[1]), 0.01);
            }
            plane[i] = std::pow(product, power);
        }
        double mean = std::accumulate(plane.begin(), plane.end(), 0.0) / double(plane_size),
               square = 0.0;
        for (double value : plane) square += (value - mean) * (value - mean);
        double threshold = mean + k * std::sqrt(square / double(plane_size));
        for (size_t i = 0; i < plane_size; i++)
            volume[z * plane_size + i] = float(std::max(plane[i] - threshold, 0.0));
    }
    return volume;
}

// ---- the result file ----------------------------------------------------------------------------

// A .npy file: a line that says what follows, and volumes (frame, z, y, x) as a processor holds them.
class ResultFile {
 public:
    ResultFile(const std::string& path, int frames, const std::array<size_t, 3>& shape)
        : file_(path, std::ios::binary) {
        std::string head = "{'descr': '<f4', 'fortran_order': False, 'shape': (" +
                           std::to_string(frames) + ", ";
        for (size_t edge : shape) head += std::to_string(edge) + ", ";
        head += ")}";
        head.resize((head.size() + 10) / 64 * 64 + 64 - 10 - 1, ' ');  // 10 bytes come before
        head += '\n';
        file_.write("\x93NUMPY\x01\x00", 8);
        file_.put(char(head.size() % 256)).put(char(head.size() / 256)) << head;
    }

    void add(const std::vector<float>& volume) {
        file_.write(reinterpret_cast<const char*>(volume.data()),
                    std::streamsize(volume.size() * sizeof(float)));
        if (!file_.flush()) throw std::runtime_error("the result cannot be written");
    }

 private:
    std::ofstream file_;
};

static double parameter(int count, char** words, const std::string& name, double otherwise) {
    for (int i = 3; i < count; i++)
        if (std::string(words[i]).rfind(name + "=", 0) == 0)
            return std::stod(words[i] + name.size() + 1);
    return otherwise;
}

static void solve(const std::string& dataset, const std::string& out, double k) {
    Rig rig(read_json(dataset + "/cameras.json"));
    ResultFile result(out, rig.frames, rig.shape);
    for (int frame = 0; frame < rig.frames; frame++) {
        std::vector<Image> images;
        for (const Camera& camera : rig.cameras) {
            char folder[64];
            std::snprintf(folder, sizeof folder, "/images/frame_%04d/", frame);
            images.push_back(normalised(dataset + folder + camera.name + ".tif", rig.black));
        }
        result.add(refocus(rig, images, k));
    }
}

int main(int count, char** words) {
    if (count < 3) {
        std::cerr << "usage: synthetic_aperture DATASET RESULT [k=3]\n";
        return 2;
    }
    try {
        solve(words[1], words[2], parameter(count, words, "k", 3.0));
    } catch (const std::exception& error) {
        std::cerr << error.what() << "\n";
        return 1;
    }
    return 0;
}
