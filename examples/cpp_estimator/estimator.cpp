// The estimator in C++: a model file is the whole of it, so ONNX Runtime is all that this needs.
//
//     estimator my_arm.onnx known.bin < readings.txt
//
// known.bin holds mean and covariance of the arm's P parameters as doubles (known.py writes it from
// a calibration). Each line of standard input has the M tensions, N, and the 2N commanded joint
// angles, rad. In a node, take them from cable_tensions and joint_commands instead.

#include <onnxruntime_cxx_api.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <vector>

using Numbers = std::vector<double>;

Ort::Value tensor(Numbers & numbers, std::vector<int64_t> shape)
{
  static const auto memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
  return Ort::Value::CreateTensor<double>(
    memory, numbers.data(), numbers.size(), shape.data(), shape.size());
}

int main(int argc, char ** argv)
{
  if (argc != 3) {
    std::fprintf(stderr, "usage: %s MODEL.onnx KNOWN.bin < READINGS\n", argv[0]);
    return 2;
  }
  Ort::Env environment(ORT_LOGGING_LEVEL_WARNING, "cablesense");
  Ort::SessionOptions options;
  options.SetIntraOpNumThreads(1);
  Ort::Session session(environment, argv[1], options);
  auto width = [&](size_t input) {
      return session.GetInputTypeInfo(input).GetTensorTypeAndShapeInfo().GetShape().back();
    };
  const int64_t cables = width(0), joints = width(1), parameters = width(2);
  Numbers reading(cables), command(joints), mean(parameters), covariance(parameters * parameters);
  Numbers still(joints * joints, 0.0);
  std::ifstream known(argv[2], std::ios::binary);
  known.read(reinterpret_cast<char *>(mean.data()), sizeof(double) * mean.size());
  known.read(reinterpret_cast<char *>(covariance.data()), sizeof(double) * covariance.size());
  if (!known) {
    std::fprintf(stderr, "%s: is not of %lld parameters\n", argv[2], (long long)parameters);
    return 2;
  }
  const std::array<const char *, 5> inputs{
    "reading_n", "command_rad", "mean", "covariance", "unrest_n2_m2"};
  const std::array<const char *, 5> outputs{
    "contact_evidence", "place_m", "force_n", "magnitude_ci95_n", "free_chi2"};
  auto take = [](Numbers & numbers) {
      return std::all_of(numbers.begin(), numbers.end(), [](double & n) {
                 return static_cast<bool>(std::cin >> n);
        });
    };
  while (take(reading) && take(command)) {
    std::array<Ort::Value, 5> given{
      tensor(reading, {1, cables}), tensor(command, {1, joints}), tensor(mean, {parameters}),
      tensor(covariance, {parameters, parameters}), tensor(still, {joints, joints})};
    auto answer = session.Run(
      Ort::RunOptions{nullptr}, inputs.data(), given.data(), 5, outputs.data(), 5);
    const double * evidence = answer[0].GetTensorData<double>();
    const double * best = std::max_element(evidence, evidence + joints / 2);
    const double * force = answer[2].GetTensorData<double>();
    const double * interval = answer[3].GetTensorData<double>();
    if (*best < 0.0) {  // against "nothing touches the arm"
      std::printf("free\n");
      continue;
    }
    std::printf(
      "segment %d at %.4f m: (%.3f, %.3f, %.3f) N, across it %.3f to %.3f N\n",
      static_cast<int>(best - evidence) + 1, answer[1].GetTensorData<double>()[0],
      force[0], force[1], force[2], interval[0], interval[1]);
  }
  return 0;
}
