// A C++ program that uses libdipole: each kind of call once. Prints R at 1 mm as it came in each
// way; exits with 1 when they differ.
#include <dipole.h>

#include <cstdio>
#include <memory>
#include <stdexcept>
#include <vector>

namespace {

struct Closer {
  void operator()(dipole_client *client) const { dipole_close(client); }
  void operator()(dipole_result *result) const { dipole_result_free(result); }
  void operator()(dipole_table *table) const { dipole_table_free(table); }
};

template <typename T> using Owner = std::unique_ptr<T, Closer>;

void check(bool good, const dipole_error &error) {
  if (!good) {
    throw std::runtime_error(error.text);
  }
}

Owner<dipole_client> open(const char *address) {
  dipole_options options;
  dipole_client *client = nullptr;
  dipole_error error;
  dipole_options_init(&options);
  options.connect_timeout_ms = 20000;
  check(dipole_open_with(address, &options, &client, &error), error);
  return Owner<dipole_client>(client);
}

std::vector<float> evaluate(dipole_client *client, const dipole_medium &skin, float radius) {
  dipole_error error;
  dipole_result *result = nullptr;
  dipole_query query{};
  query.model = dipole_id(client, DIPOLE_MODEL, "better");
  query.evaluator = DIPOLE_F32;
  query.moments = DIPOLE_EXACT;
  query.wanted = DIPOLE_R | DIPOLE_ALBEDO;
  query.media = &skin;
  query.medium_count = 1;
  query.spacing = DIPOLE_LIST;
  query.radii = &radius;
  query.radius_count = 1;
  check(dipole_eval(client, &query, &result, &error), error);
  const Owner<dipole_result> whole(result);

  float place = 0;
  std::uint64_t id = 0;
  query.into_values = &place;
  check(dipole_submit(client, &query, &id, &error), error);
  dipole_flush(client);
  check(dipole_collect_id(client, id, &result, &error), error);
  const Owner<dipole_result> in_place(result);
  return {whole->channels[0].R_f32[0], place};
}

float look_up(dipole_client *client, const dipole_medium &skin, float radius) {
  dipole_error error;
  dipole_table *table = nullptr;
  dipole_table_query query{};
  query.model = dipole_id(client, DIPOLE_MODEL, "better");
  query.moments = DIPOLE_EXACT;
  query.medium = skin;
  check(dipole_table_fetch(client, &query, &table, &error), error);
  const Owner<dipole_table> owner(table);
  float R = 0;
  if (!dipole_table_values(table, DIPOLE_R, 1, &radius, &R)) {
    throw std::runtime_error("the table does not cover the radius");
  }
  return R;
}

} // namespace

int main(int argc, char **argv) {
  try {
    const Owner<dipole_client> client = open(argc > 1 ? argv[1] : nullptr);
    const dipole_medium skin{0.032, 0.74, 0, 1.3};
    const std::vector<float> R = evaluate(client.get(), skin, 1.0f);
    const float near = look_up(client.get(), skin, 1.0f);
    std::printf("%.9g %.9g %.9g\n", double(R[0]), double(R[1]), double(near));
    return R[0] == R[1] && near > 0.999f * R[0] && near < 1.001f * R[0] ? 0 : 1;
  } catch (const std::exception &failure) {
    std::fprintf(stderr, "%s\n", failure.what());
    return 1;
  }
}
