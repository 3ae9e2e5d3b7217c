// PCD files read and written by PCL: a line of stdin names a task, a line of stdout answers with its time.
//
//   load FILE                 read a PCD; answers "<milliseconds> <points>"
//   save ascii|binary|binary_compressed FILE    write what was loaded last; answers "<milliseconds> <points>"
//   dump FILE                 write what was loaded last as plain records: x y z float, then the packed colour
//
// The cloud is kept between runs, so that PCL does not pay for fresh memory each time.
#include <cstdint>
#include <ctime>
#include <fstream>
#include <iostream>
#include <sstream>
#include <string>

#include <pcl/io/pcd_io.h>
#include <pcl/point_types.h>

namespace {

using Cloud = pcl::PointCloud<pcl::PointXYZRGB>;

// Processor time of this thread, system calls included, which other programs on the machine hardly disturb.
double milliseconds() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * now.tv_sec + 1e-6 * now.tv_nsec;
}

int load(const std::string& file, Cloud& cloud) { return pcl::io::loadPCDFile(file, cloud); }

int save(const std::string& encoding, const std::string& file, const Cloud& cloud) {
  pcl::PCDWriter writer;
  if (encoding == "ascii") return writer.writeASCII(file, cloud);
  if (encoding == "binary") return writer.writeBinary(file, cloud);
  return writer.writeBinaryCompressed(file, cloud);
}

int dump(const std::string& file, const Cloud& cloud) {
  std::ofstream out(file, std::ios::binary);
  for (const auto& point : cloud) {
    out.write(reinterpret_cast<const char*>(point.data), 3 * sizeof(float));
    out.write(reinterpret_cast<const char*>(&point.rgba), sizeof(std::uint32_t));
  }
  return out ? 0 : -1;
}

}  // namespace

int main() {
  Cloud cloud;
  std::string line;
  while (std::getline(std::cin, line)) {
    std::istringstream words(line);
    std::string task, encoding, file;
    words >> task;
    if (task == "save") words >> encoding;
    words >> file;
    const double start = milliseconds();
    int failed = -1;
    if (task == "load") failed = load(file, cloud);
    if (task == "save") failed = save(encoding, file, cloud);
    if (task == "dump") failed = dump(file, cloud);
    std::cout << (failed ? -1 : milliseconds() - start) << ' ' << cloud.size() << std::endl;
  }
}
