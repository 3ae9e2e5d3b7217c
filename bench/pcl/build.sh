#!/bin/sh
# Compile the PCL side of the kernel measurements; needs Debian's libpcl-dev and g++.
# PCL_NO_PRECOMPILE makes every template native to this processor, unlike the distribution's library.
set -e
cd "$(dirname "$0")"
mkdir -p build
version=$(ls -d /usr/include/pcl-* | sed 's/.*pcl-//' | tail -n 1)
# -march=native with AVX makes Eigen expect 32-byte malloc that the distribution's library does not give
g++ -std=c++17 -O3 -march=native -DPCL_NO_PRECOMPILE -DEIGEN_MALLOC_ALREADY_ALIGNED=1 \
    -I"/usr/include/pcl-$version" -I/usr/include/eigen3 kernels.cpp -o "${1:-build/kernels}" \
    -lpcl_io -lpcl_search -lpcl_kdtree -lpcl_octree -lpcl_features -lpcl_common -lboost_system -lflann_cpp -llz4
