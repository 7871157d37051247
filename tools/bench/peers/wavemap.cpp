// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// wavemap. Modes: image (a pinhole camera's image into the hashed chunked wavelet octree, coarse to fine,
/// one thread), ray (ray tracing into hashed blocks).
#include <wavemap/core/integrator/measurement_model/continuous_ray.h>
#include <wavemap/core/integrator/projection_model/pinhole_camera_projector.h>
#include <wavemap/core/integrator/projective/coarse_to_fine/hashed_chunked_wavelet_integrator.h>
#include <wavemap/core/integrator/ray_tracing/ray_tracing_integrator.h>
#include <wavemap/core/map/hashed_blocks.h>
#include <wavemap/core/map/hashed_chunked_wavelet_octree.h>

#include <memory>

#include "bench.hpp"

namespace {

class Peer {
 public:
  explicit Peer(const bench::Log& log) : log_(log), is_image_(log.mode == "image") {
    for (const bench::Scan& scan : log.scans) {
      const Eigen::Quaterniond turn(Eigen::Matrix3d(scan.pose.topLeftCorner<3, 3>()));
      const wavemap::Transformation3D pose(wavemap::Rotation3D(turn.normalized().cast<float>()),
                                           wavemap::Point3D(scan.origin().cast<float>()));
      const Eigen::Matrix4d to_sensor = scan.pose.inverse();
      wavemap::Image<> image(log.head.width, log.head.height);
      wavemap::Pointcloud<>::Data points(3, Eigen::Index(scan.size()));
      for (std::size_t i = 0; i < scan.size(); ++i) {
        const Eigen::Vector4d seen = to_sensor * scan.point(i).homogeneous();
        points.col(Eigen::Index(i)) = seen.head<3>().cast<float>();
        const int pixel = scan.pixels[i];
        if (is_image_ && pixel >= 0)
          image.at({pixel % log.head.width, pixel / log.head.width}) = float(seen.z());
      }
      if (is_image_) {
        images_.emplace_back(pose, std::move(image));
      } else {
        clouds_.emplace_back(pose, std::move(points));
      }
    }
  }

  void create() {
    const auto cell = float(log_.head.cell);
    const auto range = float(log_.head.max_range);
    if (!is_image_) {
      map_ = std::make_shared<wavemap::HashedBlocks>(wavemap::MapBaseConfig{cell, -2.0F, 4.0F});
      integrator_ = std::make_unique<wavemap::RayTracingIntegrator>(
          wavemap::RayTracingIntegratorConfig{0.1F, range}, map_);
      return;
    }
    wavemap::HashedChunkedWaveletOctreeConfig config;
    config.min_cell_width = cell;
    const auto octree = std::make_shared<wavemap::HashedChunkedWaveletOctree>(config);
    map_ = octree;
    const bench::Header& head = log_.head;
    const auto camera = std::make_shared<wavemap::PinholeCameraProjector>(
        wavemap::PinholeCameraProjectorConfig{float(head.focal), float(head.focal), float(head.center[0]),
                                              float(head.center[1]), head.height, head.width});
    const auto image = std::make_shared<wavemap::PosedImage<>>(camera->getDimensions());
    const auto offsets = std::make_shared<wavemap::Image<wavemap::Vector2D>>(camera->getDimensions());
    const auto model = std::make_shared<wavemap::ContinuousRay>(
        wavemap::ContinuousRayConfig{0.5F * cell, 0.2F, 0.4F}, camera, image);
    integrator_ = std::make_unique<wavemap::HashedChunkedWaveletIntegrator>(
        wavemap::ProjectiveIntegratorConfig{0.1F, range}, camera, image, offsets, model, octree,
        std::make_shared<wavemap::ThreadPool>(1));
  }
  void insert(std::size_t s) {
    if (is_image_) {
      integrator_->integrate(images_[s]);
    } else {
      integrator_->integrate(clouds_[s]);
    }
    if (s % 50 == 49) map_->threshold();
  }
  void finish() {
    map_->threshold();
    map_->prune();
  }

 private:
  const bench::Log& log_;
  bool is_image_;
  std::vector<wavemap::PosedImage<>> images_;
  std::vector<wavemap::PosedPointcloud<>> clouds_;
  wavemap::MapBase::Ptr map_;
  std::unique_ptr<wavemap::IntegratorBase> integrator_;
};

}  // namespace

int main(int count, char** arguments) { return bench::run<Peer>("wavemap", count, arguments); }
