#!/bin/sh
# Compiles the roscpp chain. Debian 12: apt-get install libroscpp-dev libsensor-msgs-dev python3-rosmaster g++
set -eu
cd "$(dirname "$0")"
mkdir -p build
g++ -std=c++17 -O3 -march=native -DBOOST_BIND_GLOBAL_PLACEHOLDERS chain.cpp -o build/chain \
    -lroscpp -lroscpp_serialization -lrosconsole -lrostime -lxmlrpcpp -lcpp_common -lboost_thread -lpthread
