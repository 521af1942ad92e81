// Drives a fuzz target without libFuzzer: files named as arguments, or inputs of a fixed seed, so that every compiler
// and every sanitizer runs the target as an ordinary test.
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <random>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    std::ifstream file(argv[i], std::ios::binary);
    const std::vector<char> bytes{std::istreambuf_iterator<char>(file), {}};
    const std::vector<std::uint8_t> input(bytes.begin(), bytes.end());
    LLVMFuzzerTestOneInput(input.data(), input.size());
  }
  if (argc > 1) return 0;

  std::mt19937 generator(20240229);
  constexpr int kInputs = 120;
  for (int i = 0; i < kInputs; ++i) {
    // Empty first, then lengths that spread over the powers of two; every third input is sparse.
    const std::size_t bits = i == 0 ? 0 : generator() % 12;
    std::vector<std::uint8_t> input((std::size_t{1} << bits) - 1 + generator() % (std::size_t{1} << bits));
    for (auto& byte : input) byte = static_cast<std::uint8_t>(i % 3 == 0 && generator() % 8 != 0 ? 0 : generator());
    LLVMFuzzerTestOneInput(input.data(), input.size());
  }
  std::printf("%d inputs\n", kInputs);
  return 0;
}
