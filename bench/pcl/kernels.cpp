// The kernels' work done by PCL: a line of stdin names a task, a line of stdout answers with its time.
//
//   load FILE            read a PCD into memory (not timed)
//   pose M00 .. M23      place the cloud in the world for the tasks that work there (not timed)
//   <task> [numbers]     run once; answers "<milliseconds> <count>"
//   dump FILE            write the result of the last task: points as 4 floats each, or indices as int32
//
// Every task is timed around PCL's own calls; output clouds are kept between runs, so that PCL does not pay for fresh
// memory each time either.
#include <cstdint>
#include <cstring>
#include <ctime>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include <pcl/common/centroid.h>
#include <pcl/common/common.h>
#include <pcl/common/transforms.h>
#include <pcl/features/integral_image_normal.h>
#include <pcl/features/normal_3d.h>
#include <pcl/filters/crop_box.h>
#include <pcl/filters/filter.h>
#include <pcl/filters/passthrough.h>
#include <pcl/filters/radius_outlier_removal.h>
#include <pcl/filters/statistical_outlier_removal.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/io/pcd_io.h>
#include <pcl/point_types.h>
#include <pcl/registration/icp.h>
#include <pcl/sample_consensus/method_types.h>
#include <pcl/sample_consensus/model_types.h>
#include <pcl/search/kdtree.h>
#include <pcl/segmentation/extract_clusters.h>
#include <pcl/segmentation/organized_multi_plane_segmentation.h>
#include <pcl/segmentation/sac_segmentation.h>

using Point = pcl::PointXYZRGB;
using Cloud = pcl::PointCloud<Point>;
using Normals = pcl::PointCloud<pcl::Normal>;
using Numbers = std::vector<double>;

// Processor time of this thread in milliseconds: what other programs on the machine take does not count.
static double now() {
  timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return t.tv_sec * 1e3 + t.tv_nsec * 1e-6;
}

struct Bench {
  Cloud::Ptr cloud{new Cloud}, dense{new Cloud}, world{new Cloud}, out{new Cloud};
  Normals::Ptr normals{new Normals};
  Eigen::Matrix4f pose = Eigen::Matrix4f::Identity();
  std::vector<int> indices;         // result: point numbers, or one label a point
  std::vector<float> numbers;       // result: anything else
  enum { kCloud, kIndices, kNumbers, kNormals } last = kCloud;
  pcl::Indices scratch;
  double begin = 0;

  void start() { begin = now(); }
  double stop() const { return now() - begin; }
};

static double voxel(Bench& b, const Numbers& a) {
  b.start();
  pcl::VoxelGrid<Point> grid;
  grid.setInputCloud(b.cloud);
  grid.setLeafSize(a[0], a[0], a[0]);
  grid.filter(*b.out);
  b.last = Bench::kCloud;
  return b.stop();
}

static double transform(Bench& b, const Numbers&) {
  b.start();
  pcl::transformPointCloud(*b.cloud, *b.out, b.pose);
  b.last = Bench::kCloud;
  return b.stop();
}

static double remove_nan(Bench& b, const Numbers&) {
  b.start();
  pcl::removeNaNFromPointCloud(*b.cloud, *b.out, b.scratch);
  b.last = Bench::kCloud;
  return b.stop();
}

static double pass_through(Bench& b, const Numbers& a) {
  b.start();
  pcl::PassThrough<Point> pass;
  pass.setInputCloud(b.cloud);
  pass.setFilterFieldName("z");
  pass.setFilterLimits(a[0], a[1]);
  pass.filter(*b.out);
  b.last = Bench::kCloud;
  return b.stop();
}

static double crop_box(Bench& b, const Numbers& a) {
  b.start();
  pcl::CropBox<Point> box;
  box.setInputCloud(b.cloud);
  box.setMin(Eigen::Vector4f(a[0], a[1], a[2], 1));
  box.setMax(Eigen::Vector4f(a[3], a[4], a[5], 1));
  box.filter(*b.out);
  b.last = Bench::kCloud;
  return b.stop();
}

static double bounding_box(Bench& b, const Numbers&) {
  b.start();
  Point low, high;
  pcl::getMinMax3D(*b.cloud, low, high);
  b.numbers = {low.x, low.y, low.z, high.x, high.y, high.z};
  b.last = Bench::kNumbers;
  return b.stop();
}

static double centroid(Bench& b, const Numbers&) {
  b.start();
  Eigen::Vector4f c;
  pcl::compute3DCentroid(*b.cloud, c);
  b.numbers = {c[0], c[1], c[2]};
  b.last = Bench::kNumbers;
  return b.stop();
}

// The book's way from a selected patch to the points of its plane: moments of the patch, a frame on the plane, the
// whole cloud moved into that frame, a pass-through in z, the indices copied. a: patch u0 v0 u1 v1, tolerance.
static double find_plane(Bench& b, const Numbers& a) {
  b.start();
  pcl::Indices patch;
  for (int v = a[1]; v < int(a[3]); ++v)
    for (int u = a[0]; u < int(a[2]); ++u) patch.push_back(v * b.cloud->width + u);
  Eigen::Matrix3f covariance;
  Eigen::Vector4f middle;
  pcl::computeMeanAndCovarianceMatrix(*b.cloud, patch, covariance, middle);
  float value;
  Eigen::Vector3f z;
  pcl::eigen33(covariance, value, z);
  if (z.dot(middle.head<3>()) > 0) z = -z;
  Eigen::Vector3f x = (Eigen::Vector3f::UnitX() - z[0] * z).normalized(), y = z.cross(x);
  Eigen::Matrix4f into = Eigen::Matrix4f::Identity();
  into.block<1, 3>(0, 0) = x.transpose();
  into.block<1, 3>(1, 0) = y.transpose();
  into.block<1, 3>(2, 0) = z.transpose();
  into.block<3, 1>(0, 3) = -into.block<3, 3>(0, 0) * middle.head<3>();
  static Cloud::Ptr moved(new Cloud);
  pcl::transformPointCloud(*b.cloud, *moved, into);
  pcl::PassThrough<Point> pass;
  pass.setInputCloud(moved);
  pass.setFilterFieldName("z");
  pass.setFilterLimits(-a[4], a[4]);
  pass.filter(b.scratch);
  pcl::copyPointCloud(*b.cloud, b.scratch, *b.out);
  const double elapsed = b.stop();
  b.indices.assign(b.scratch.begin(), b.scratch.end());
  b.last = Bench::kIndices;
  return elapsed;
}

// a: threshold, most iterations
static double ransac(Bench& b, const Numbers& a) {
  pcl::ModelCoefficients model;
  pcl::PointIndices inliers;
  b.start();
  pcl::SACSegmentation<Point> sac;
  sac.setModelType(pcl::SACMODEL_PLANE);
  sac.setMethodType(pcl::SAC_RANSAC);
  sac.setOptimizeCoefficients(true);
  sac.setDistanceThreshold(a[0]);
  sac.setMaxIterations(int(a[1]));
  sac.setInputCloud(b.dense);
  sac.segment(inliers, model);
  const double elapsed = b.stop();
  b.numbers.assign(model.values.begin(), model.values.end());
  b.numbers.push_back(float(inliers.indices.size()));
  b.last = Bench::kNumbers;
  return elapsed;
}

static double table_height(Bench& b, double low, double high, double slab) {
  pcl::PassThrough<Point> pass;
  pass.setInputCloud(b.world);
  pass.setFilterFieldName("z");
  double best = 0;
  std::size_t most = 0;
  b.numbers.clear();
  for (double z = low; z < high; z += slab) {
    pass.setFilterLimits(z, z + slab);
    pass.filter(b.scratch);
    b.numbers.push_back(float(b.scratch.size()));
    if (b.scratch.size() > most) {
      most = b.scratch.size();
      best = z + 0.5 * slab;
    }
  }
  return best;
}

// The book's search by one filter a slab. a: low, high, slab
static double slabs(Bench& b, const Numbers& a) {
  b.start();
  table_height(b, a[0], a[1], a[2]);
  b.last = Bench::kNumbers;
  return b.stop();
}

static void fit(const Cloud& cloud, const pcl::Indices& indices, std::vector<float>& numbers) {
  Eigen::Matrix3f covariance;
  Eigen::Vector4f middle;
  pcl::computeMeanAndCovarianceMatrix(cloud, indices, covariance, middle);
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3f> solver(covariance);
  const Eigen::Vector3f n = solver.eigenvectors().col(0), m = solver.eigenvectors().col(2);
  numbers = {n[0], n[1], n[2], m[0], m[1], m[2], middle[0], middle[1], middle[2], float(indices.size())};
}

// Plane, major axis and centroid of a slab of the world cloud. a: low, high
static double slab_fit(Bench& b, const Numbers& a) {
  b.start();
  pcl::PassThrough<Point> pass;
  pass.setInputCloud(b.world);
  pass.setFilterFieldName("z");
  pass.setFilterLimits(a[0], a[1]);
  pass.filter(b.scratch);
  fit(*b.world, b.scratch, b.numbers);
  b.last = Bench::kNumbers;
  return b.stop();
}

// The book's finder: into the world, table height, the slab above it, its plane and axes. a: low, high, slab
static double finder_chain(Bench& b, const Numbers& a) {
  b.start();
  pcl::transformPointCloud(*b.cloud, *b.world, b.pose);
  const double height = table_height(b, a[0], a[1], a[2]);
  pcl::PassThrough<Point> pass;
  pass.setInputCloud(b.world);
  pass.setFilterFieldName("z");
  pass.setFilterLimits(height + 0.025, height + 0.045);
  pass.filter(b.scratch);
  if (b.scratch.size() >= 3) fit(*b.world, b.scratch, b.numbers);
  b.last = Bench::kNumbers;
  return b.stop();
}

// Clusters of what stands above a plane. a: nx ny nz d, low, high, tolerance, least size
static double clusters(Bench& b, const Numbers& a) {
  std::vector<pcl::PointIndices> found;
  pcl::IndicesPtr above(new pcl::Indices);
  b.start();
  for (std::size_t i = 0; i < b.cloud->size(); ++i) {
    const auto& p = (*b.cloud)[i];
    const float h = float(a[0]) * p.x + float(a[1]) * p.y + float(a[2]) * p.z - float(a[3]);
    if (h >= float(a[4]) && h <= float(a[5])) above->push_back(int(i));
  }
  pcl::search::KdTree<Point>::Ptr tree(new pcl::search::KdTree<Point>);
  tree->setInputCloud(b.cloud, above);
  pcl::EuclideanClusterExtraction<Point> extraction;
  extraction.setClusterTolerance(a[6]);
  extraction.setMinClusterSize(int(a[7]));
  extraction.setSearchMethod(tree);
  extraction.setInputCloud(b.cloud);
  extraction.setIndices(above);
  extraction.extract(found);
  const double elapsed = b.stop();
  b.indices.assign(b.cloud->size(), -1);
  for (std::size_t k = 0; k < found.size(); ++k)
    for (int i : found[k].indices) b.indices[i] = int(k);
  b.last = Bench::kIndices;
  return elapsed;
}

static void image_normals(Bench& b, double change, double smoothing) {
  pcl::IntegralImageNormalEstimation<Point, pcl::Normal> estimation;
  estimation.setNormalEstimationMethod(estimation.COVARIANCE_MATRIX);
  estimation.setMaxDepthChangeFactor(change);
  estimation.setNormalSmoothingSize(smoothing);
  estimation.setInputCloud(b.cloud);
  estimation.compute(*b.normals);
}

// a: greatest depth change, smoothing size
static double normals_image(Bench& b, const Numbers& a) {
  b.start();
  image_normals(b, a[0], a[1]);
  b.last = Bench::kNormals;
  return b.stop();
}

// Normals and planes of an organised cloud. a: depth change, smoothing, least inliers, angle (radians), distance
static double multi_plane(Bench& b, const Numbers& a) {
  std::vector<pcl::PlanarRegion<Point>, Eigen::aligned_allocator<pcl::PlanarRegion<Point>>> regions;
  std::vector<pcl::ModelCoefficients> models;
  std::vector<pcl::PointIndices> inliers, label_indices, boundaries;
  pcl::PointCloud<pcl::Label>::Ptr labels(new pcl::PointCloud<pcl::Label>);
  b.start();
  image_normals(b, a[0], a[1]);
  pcl::OrganizedMultiPlaneSegmentation<Point, pcl::Normal, pcl::Label> segmentation;
  segmentation.setMinInliers(unsigned(a[2]));
  segmentation.setAngularThreshold(a[3]);
  segmentation.setDistanceThreshold(a[4]);
  segmentation.setInputNormals(b.normals);
  segmentation.setInputCloud(b.cloud);
  segmentation.segmentAndRefine(regions, models, inliers, labels, label_indices, boundaries);
  const double elapsed = b.stop();
  b.indices.assign(b.cloud->size(), -1);
  for (std::size_t k = 0; k < inliers.size(); ++k)
    for (int i : inliers[k].indices) b.indices[i] = int(k);
  b.last = Bench::kIndices;
  return elapsed;
}

// Normals by nearest neighbours. a: number of neighbours
static double normals_nearest(Bench& b, const Numbers& a) {
  b.start();
  pcl::NormalEstimation<Point, pcl::Normal> estimation;
  pcl::search::KdTree<Point>::Ptr tree(new pcl::search::KdTree<Point>);
  estimation.setSearchMethod(tree);
  estimation.setKSearch(int(a[0]));
  estimation.setInputCloud(b.dense);
  estimation.compute(*b.normals);
  b.last = Bench::kNormals;
  return b.stop();
}

// Normals by all neighbours within a radius. a: radius
static double normals_radius(Bench& b, const Numbers& a) {
  b.start();
  pcl::NormalEstimation<Point, pcl::Normal> estimation;
  pcl::search::KdTree<Point>::Ptr tree(new pcl::search::KdTree<Point>);
  estimation.setSearchMethod(tree);
  estimation.setRadiusSearch(a[0]);
  estimation.setInputCloud(b.dense);
  estimation.compute(*b.normals);
  b.last = Bench::kNormals;
  return b.stop();
}

// a: number of neighbours, multiple of the standard deviation
static double statistical_outliers(Bench& b, const Numbers& a) {
  b.start();
  pcl::StatisticalOutlierRemoval<Point> removal;
  removal.setInputCloud(b.dense);
  removal.setMeanK(int(a[0]));
  removal.setStddevMulThresh(a[1]);
  removal.filter(b.scratch);
  const double elapsed = b.stop();
  b.indices.assign(b.scratch.begin(), b.scratch.end());
  b.last = Bench::kIndices;
  return elapsed;
}

// a: radius, least neighbours
static double radius_outliers(Bench& b, const Numbers& a) {
  b.start();
  pcl::RadiusOutlierRemoval<Point> removal;
  removal.setInputCloud(b.dense);
  removal.setRadiusSearch(a[0]);
  removal.setMinNeighborsInRadius(int(a[1]));
  removal.filter(b.scratch);
  const double elapsed = b.stop();
  b.indices.assign(b.scratch.begin(), b.scratch.end());
  b.last = Bench::kIndices;
  return elapsed;
}

// The nearest point of the dense cloud to each point of the shifted dense cloud. a: shift x y z, greatest distance
static double nearest(Bench& b, const Numbers& a) {
  static Cloud::Ptr shifted(new Cloud);
  *shifted = *b.dense;
  for (auto& p : *shifted) p.x += float(a[0]), p.y += float(a[1]), p.z += float(a[2]);
  b.start();
  pcl::search::KdTree<Point> tree;
  tree.setInputCloud(b.dense);
  b.indices.assign(shifted->size(), -1);
  pcl::Indices found(1);
  std::vector<float> square(1);
  for (std::size_t i = 0; i < shifted->size(); ++i)
    if (tree.nearestKSearch((*shifted)[i], 1, found, square) > 0 && square[0] <= float(a[3] * a[3])) b.indices[i] = found[0];
  b.last = Bench::kIndices;
  return b.stop();
}

static double concatenate(Bench& b, const Numbers&) {
  b.start();
  Cloud::concatenate(*b.cloud, *b.dense, *b.out);
  b.last = Bench::kCloud;
  return b.stop();
}

static double load_file(Bench& b, const std::string& path) {
  b.start();
  pcl::io::loadPCDFile(path, *b.out);
  b.last = Bench::kCloud;
  return b.stop();
}

static double save_file(Bench& b, const std::string& kind, const std::string& path) {
  b.start();
  pcl::PCDWriter writer;
  if (kind == "binary") writer.writeBinary(path, *b.cloud);
  if (kind == "compressed") writer.writeBinaryCompressed(path, *b.cloud);
  if (kind == "ascii") writer.writeASCII(path, *b.cloud);
  return b.stop();
}

static std::size_t count(const Bench& b) {
  switch (b.last) {
    case Bench::kCloud: return b.out->size();
    case Bench::kIndices: return b.indices.size();
    case Bench::kNormals: return b.normals->size();
    default: return b.numbers.size();
  }
}

static void dump(const Bench& b, const std::string& path) {
  std::ofstream file(path, std::ios::binary);
  if (b.last == Bench::kIndices) file.write(reinterpret_cast<const char*>(b.indices.data()), 4 * b.indices.size());
  if (b.last == Bench::kNumbers) file.write(reinterpret_cast<const char*>(b.numbers.data()), 4 * b.numbers.size());
  if (b.last == Bench::kNormals)
    for (const auto& n : *b.normals) {
      const float row[4] = {n.normal_x, n.normal_y, n.normal_z, n.curvature};
      file.write(reinterpret_cast<const char*>(row), sizeof row);
    }
  if (b.last == Bench::kCloud)
    for (const auto& p : *b.out) {
      float row[4] = {p.x, p.y, p.z, 0};
      std::memcpy(row + 3, &p.rgba, 4);
      file.write(reinterpret_cast<const char*>(row), sizeof row);
    }
}

static void load(Bench& b, const std::string& path) {
  if (pcl::io::loadPCDFile(path, *b.cloud) != 0) throw std::runtime_error("cannot read " + path);
  pcl::Indices kept;
  pcl::removeNaNFromPointCloud(*b.cloud, *b.dense, kept);
  *b.world = *b.cloud;
}

static void place(Bench& b, std::istream& line) {
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 4; ++column) line >> b.pose(row, column);
  pcl::transformPointCloud(*b.cloud, *b.world, b.pose);
}

int main() {
  const std::map<std::string, std::function<double(Bench&, const Numbers&)>> tasks{
      {"voxel", voxel},
      {"transform", transform},
      {"remove_nan", remove_nan},
      {"pass_through", pass_through},
      {"crop_box", crop_box},
      {"bounding_box", bounding_box},
      {"centroid", centroid},
      {"find_plane", find_plane},
      {"ransac", ransac},
      {"slabs", slabs},
      {"slab_fit", slab_fit},
      {"finder_chain", finder_chain},
      {"clusters", clusters},
      {"normals_image", normals_image},
      {"multi_plane", multi_plane},
      {"normals_nearest", normals_nearest},
      {"normals_radius", normals_radius},
      {"statistical_outliers", statistical_outliers},
      {"radius_outliers", radius_outliers},
      {"nearest", nearest},
      {"concatenate", concatenate},
  };
  Bench b;
  for (std::string text; std::getline(std::cin, text);) {
    std::istringstream line(text);
    std::string task, word, other;
    line >> task;
    double elapsed = 0;
    if (task == "load") {
      line >> word;
      load(b, word);
      std::cout << 0 << ' ' << b.cloud->size() << std::endl;
      continue;
    }
    if (task == "pose") {
      place(b, line);
    } else if (task == "dump") {
      line >> word;
      dump(b, word);
    } else if (task == "load_file") {
      line >> word;
      elapsed = load_file(b, word);
    } else if (task == "save_file") {
      line >> word >> other;
      elapsed = save_file(b, word, other);
    } else if (tasks.count(task)) {
      Numbers numbers;
      for (double number; line >> number;) numbers.push_back(number);
      elapsed = tasks.at(task)(b, numbers);
    } else {
      std::cout << "error unknown task " << task << std::endl;
      continue;
    }
    std::cout << elapsed << ' ' << count(b) << std::endl;
  }
}
