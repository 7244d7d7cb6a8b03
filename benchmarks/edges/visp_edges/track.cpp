// Pose of a model in single images by ViSP's edge tracker. Written against its public interface; this program
// links ViSP, whose licence is the GPL: what you compile here is for your own use (see ../visp_tracker.py).
//
//   track JOB > RESULT
//
// JOB, words apart by white space:
//   model FILE.cao    camera px py u0 v0    appear deg    disappear deg    good share
//   edges threshold mu1 mu2 mask_size masks sample_step
//   rounds n, range_1 ... range_n (search in pixels), tracks a round
//   views n, then for each: image, image before or "-", and the start, cMo, 12 numbers by rows
// RESULT: a line a view, "ok" or "lost"; 12 numbers of cMo; 36 of the covariance of (t, theta u); moving edges
// that were used, sum of their robust weights, normalised rms residual, projection error in degrees,
// seconds of the processor.

#include <cmath>
#include <ctime>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpException.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpImage.h>
#include <visp3/core/vpMath.h>
#include <visp3/io/vpImageIo.h>
#include <visp3/mbt/vpMbGenericTracker.h>

namespace {

struct Settings {
  std::string model;
  double px, py, u0, v0;
  double appear_deg, disappear_deg, good_share;
  double threshold, mu1, mu2;
  unsigned mask_size, masks;
  double sample_step;
  std::vector<unsigned> ranges;
  unsigned tracks;
};

struct View {
  std::string image, before;
  vpHomogeneousMatrix start;
};

template <typename T> T next(std::istream &in, const char *what) {
  T value;
  if (!(in >> value)) {
    throw std::runtime_error(std::string("job: ") + what + " is missing or is no number");
  }
  return value;
}

void word(std::istream &in, const std::string &expected) {
  if (next<std::string>(in, expected.c_str()) != expected) {
    throw std::runtime_error("job: expected '" + expected + "'");
  }
}

Settings read_settings(std::istream &in) {
  Settings s;
  word(in, "model");
  s.model = next<std::string>(in, "model");
  word(in, "camera");
  for (double *value : {&s.px, &s.py, &s.u0, &s.v0}) {
    *value = next<double>(in, "camera");
  }
  word(in, "appear");
  s.appear_deg = next<double>(in, "appear");
  word(in, "disappear");
  s.disappear_deg = next<double>(in, "disappear");
  word(in, "good");
  s.good_share = next<double>(in, "good");
  word(in, "edges");
  for (double *value : {&s.threshold, &s.mu1, &s.mu2}) {
    *value = next<double>(in, "edges");
  }
  s.mask_size = next<unsigned>(in, "mask size");
  s.masks = next<unsigned>(in, "masks");
  s.sample_step = next<double>(in, "sample step");
  word(in, "rounds");
  s.ranges.resize(next<unsigned>(in, "rounds"));
  for (unsigned &range : s.ranges) {
    range = next<unsigned>(in, "range");
  }
  s.tracks = next<unsigned>(in, "tracks");
  return s;
}

View read_view(std::istream &in) {
  View view;
  view.image = next<std::string>(in, "image");
  view.before = next<std::string>(in, "image before");
  for (unsigned i = 0; i < 3; i++) {
    for (unsigned j = 0; j < 4; j++) {
      view.start[i][j] = next<double>(in, "start");
    }
  }
  return view;
}

vpMe edges(const Settings &s, unsigned range) {
  vpMe me;
  me.setMaskSize(s.mask_size);
  me.setMaskNumber(s.masks);
  me.setRange(range);
  me.setThreshold(s.threshold);
  me.setMu1(s.mu1);
  me.setMu2(s.mu2);
  me.setSampleStep(s.sample_step);
  return me;
}

void set_up(vpMbGenericTracker &tracker, const Settings &s) {
  vpCameraParameters camera;
  camera.initPersProjWithoutDistortion(s.px, s.py, s.u0, s.v0);
  tracker.setTrackerType(vpMbGenericTracker::EDGE_TRACKER);
  tracker.setMovingEdge(edges(s, s.ranges.front()));
  tracker.setCameraParameters(camera);
  tracker.setAngleAppear(vpMath::rad(s.appear_deg));
  tracker.setAngleDisappear(vpMath::rad(s.disappear_deg));
  tracker.setNearClippingDistance(0.05);
  tracker.setFarClippingDistance(100.0);
  tracker.setClipping(tracker.getClipping() | vpMbtPolygon::FOV_CLIPPING);
  tracker.setScanLineVisibilityTest(true);
  tracker.setGoodMovingEdgesRatioThreshold(s.good_share);
  tracker.setCovarianceComputation(true);
  tracker.setProjectionErrorComputation(true);
  tracker.loadModel(s.model);
}

void numbers(std::ostream &out, const vpMatrix &m, unsigned rows, unsigned columns) {
  for (unsigned i = 0; i < rows; i++) {
    for (unsigned j = 0; j < columns; j++) {
      out << ' ' << m[i][j];
    }
  }
}

void solve(const Settings &s, const View &view, std::ostream &out) {
  vpImage<unsigned char> image, before;
  vpImageIo::read(image, view.image);
  const bool primed = view.before != "-";
  if (primed) {
    vpImageIo::read(before, view.before);
  }
  vpMbGenericTracker tracker;
  set_up(tracker, s);
  const std::clock_t begin = std::clock();
  vpHomogeneousMatrix pose = view.start;
  bool lost = false;
  try {
    for (unsigned round = 0; round < s.ranges.size(); round++) {
      // Sites are sampled along the model as it is now; only a new start samples them again.
      tracker.setMovingEdge(edges(s, s.ranges[round]));
      tracker.initFromPose(primed && round == 0 ? before : image, pose);
      for (unsigned k = 0; k < s.tracks; k++) {
        tracker.track(image);
        tracker.getPose(pose);
      }
    }
  } catch (const vpException &problem) {
    std::cerr << view.image << ": " << problem.getMessage() << '\n';
    lost = true;
  }
  const double seconds = double(std::clock() - begin) / CLOCKS_PER_SEC;
  vpMatrix covariance(6, 6);
  double count = 0, weights = 0, squares = 0, projection_deg = 90.0;
  if (!lost) {
    covariance = tracker.getCovarianceMatrix();
    projection_deg = tracker.getProjectionError();
    const vpColVector error = tracker.getError(), w = tracker.getRobustWeights();
    count = error.size();
    for (unsigned i = 0; i < error.size(); i++) {
      weights += w[i];
      squares += w[i] * error[i] * error[i];
    }
  }
  out << (lost ? "lost" : "ok");
  numbers(out, pose, 3, 4);
  numbers(out, covariance, 6, 6);
  out << ' ' << count << ' ' << weights << ' ' << (weights > 0 ? std::sqrt(squares / weights) : 0.0) << ' '
      << projection_deg << ' ' << seconds << '\n';
}

} // namespace

int main(int argc, char **argv) {
  try {
    if (argc != 2) {
      throw std::runtime_error("usage: track JOB");
    }
    std::ifstream job(argv[1]);
    const Settings settings = read_settings(job);
    word(job, "views");
    std::cout << std::setprecision(17);
    for (unsigned left = next<unsigned>(job, "views"); left > 0; left--) {
      solve(settings, read_view(job), std::cout);
    }
  } catch (const std::exception &problem) {
    std::cerr << "track: " << problem.what() << '\n';
    return 2;
  }
  return 0;
}
