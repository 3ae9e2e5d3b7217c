// Camera -> voxel -> sink with roscpp, the work that bench/chain.py measures: `chain camera|voxel|sink [FILE H W RATE]`.
// FILE holds H x W points of 16 bytes: x, y, z as float32 in metres, and rgb packed into the bits of a float32.

#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <string>
#include <vector>

using Cloud = sensor_msgs::PointCloud2;

namespace {

constexpr std::size_t kStep = 16;
constexpr float kLeaf = 0.02F;

void describe(Cloud& cloud, std::uint32_t height, std::uint32_t width) {
  cloud.header.frame_id = "camera_optical_frame";
  cloud.height = height;
  cloud.width = width;
  cloud.point_step = kStep;
  cloud.row_step = width * kStep;
  const char* names[] = {"x", "y", "z", "rgb"};
  cloud.fields.resize(4);
  for (std::uint32_t i = 0; i < 4; ++i) {
    cloud.fields[i].name = names[i];
    cloud.fields[i].offset = 4 * i;
    cloud.fields[i].datatype = sensor_msgs::PointField::FLOAT32;
    cloud.fields[i].count = 1;
  }
}

// The centroids and mean colours of occupied voxels, by a table with open addressing.
class VoxelGrid {
 public:
  void run(const Cloud& in, Cloud& out) {
    const std::size_t count = in.data.size() / kStep;
    voxels_.clear();
    slots_.assign(1U << 20U, -1);
    const float inverse = 1.0F / kLeaf;
    for (std::size_t i = 0; i < count; ++i) {
      float p[3];
      std::uint32_t rgb;
      std::memcpy(p, &in.data[i * kStep], sizeof p);
      std::memcpy(&rgb, &in.data[i * kStep + 12], sizeof rgb);
      if (!std::isfinite(p[0]) || !std::isfinite(p[1]) || !std::isfinite(p[2])) continue;
      Voxel& voxel = find(key(p[0] * inverse, p[1] * inverse, p[2] * inverse));
      voxel.x += p[0];
      voxel.y += p[1];
      voxel.z += p[2];
      voxel.r += rgb >> 16U & 255U;
      voxel.g += rgb >> 8U & 255U;
      voxel.b += rgb & 255U;
      voxel.points += 1;
    }
    describe(out, 1, static_cast<std::uint32_t>(voxels_.size()));
    out.header = in.header;
    out.is_dense = 1;
    out.data.resize(voxels_.size() * kStep);
    for (std::size_t i = 0; i < voxels_.size(); ++i) {
      const Voxel& v = voxels_[i];
      const double share = 1.0 / v.points;
      const float p[3] = {float(v.x * share), float(v.y * share), float(v.z * share)};
      const std::uint32_t rgb = std::uint32_t(v.r * share) << 16U | std::uint32_t(v.g * share) << 8U | std::uint32_t(v.b * share);
      std::memcpy(&out.data[i * kStep], p, sizeof p);
      std::memcpy(&out.data[i * kStep + 12], &rgb, sizeof rgb);
    }
  }

 private:
  struct Voxel {
    std::uint64_t key;
    double x, y, z;
    std::uint32_t r, g, b, points;
  };

  static std::uint64_t key(float x, float y, float z) {
    const auto part = [](float value) { return std::uint64_t(std::int64_t(std::floor(value)) + (1 << 20)) & 0x1FFFFFU; };
    return part(x) | part(y) << 21U | part(z) << 42U;
  }

  Voxel& find(std::uint64_t key) {
    if (!voxels_.empty() && voxels_[last_].key == key) return voxels_[last_];
    std::size_t slot = key * 0x9E3779B97F4A7C15U >> 44U;
    while (slots_[slot] >= 0 && voxels_[std::size_t(slots_[slot])].key != key) slot = (slot + 1) % slots_.size();
    if (slots_[slot] < 0) {
      slots_[slot] = static_cast<int>(voxels_.size());
      voxels_.push_back(Voxel{key, 0, 0, 0, 0, 0, 0, 0});
    }
    last_ = std::size_t(slots_[slot]);
    return voxels_[last_];
  }

  std::vector<Voxel> voxels_;
  std::vector<int> slots_;
  std::size_t last_ = 0;
};

void camera(ros::NodeHandle& node, char** words) {
  auto publisher = node.advertise<Cloud>("points", 1);
  Cloud cloud;
  describe(cloud, std::uint32_t(std::stoul(words[1])), std::uint32_t(std::stoul(words[2])));
  std::ifstream file(words[0], std::ios::binary);
  cloud.data.assign(std::istreambuf_iterator<char>(file), {});
  for (ros::WallRate rate(std::stod(words[3])); ros::ok(); rate.sleep()) {
    cloud.header.stamp = ros::Time::now();
    publisher.publish(cloud);
    ros::spinOnce();
  }
}

void voxel(ros::NodeHandle& node) {
  auto publisher = node.advertise<Cloud>("voxel", 1);
  VoxelGrid grid;
  Cloud smaller;
  auto take = [&](const Cloud::ConstPtr& cloud) {
    grid.run(*cloud, smaller);
    publisher.publish(smaller);
  };
  auto subscriber = node.subscribe<Cloud>("points", 1, take, ros::VoidConstPtr(), ros::TransportHints().tcpNoDelay());
  ros::spin();
}

void sink(ros::NodeHandle& node) {
  auto take = [](const Cloud::ConstPtr& cloud) {
    const auto now = ros::Time::now();
    std::printf("%llu %lld\n", static_cast<unsigned long long>(cloud->header.stamp.toNSec()),
                static_cast<long long>((now - cloud->header.stamp).toNSec()));
    std::fflush(stdout);
  };
  auto subscriber = node.subscribe<Cloud>("voxel", 1, take, ros::VoidConstPtr(), ros::TransportHints().tcpNoDelay());
  ros::spin();
}

}  // namespace

int main(int argc, char** argv) {
  const std::string role = argc > 1 ? argv[1] : "";
  ros::init(argc, argv, "chain_" + role, ros::init_options::NoSigintHandler | ros::init_options::NoRosout);
  ros::NodeHandle node;
  if (role == "camera" && argc == 6) camera(node, argv + 2);
  else if (role == "voxel") voxel(node);
  else if (role == "sink") sink(node);
  else return 2;
}
