// A C++ program that uses libdipole: each kind of call once. Prints R at 1 mm as it came in each
// way; exits with 1 when they differ, or when the model of a query is unknown and is not refused.
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
  dipole_query query;
  dipole_query_init(&query);
  query.model = dipole_id(client, DIPOLE_MODEL, "better");
  query.evaluator = DIPOLE_F32;
  query.wanted |= DIPOLE_ALBEDO;
  query.media = &skin;
  query.medium_count = 1;
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

// Evaluates a query of which only the medium and the radius are set.
float evaluate_usual(dipole_client *client, const dipole_medium &skin, float radius) {
  dipole_error error;
  dipole_result *result = nullptr;
  dipole_query query;
  dipole_query_init(&query);
  query.media = &skin;
  query.medium_count = 1;
  query.radii = &radius;
  query.radius_count = 1;
  check(dipole_eval(client, &query, &result, &error), error);
  const Owner<dipole_result> owner(result);
  if (result->model != dipole_id(client, DIPOLE_MODEL, "transport")) {
    throw std::runtime_error("the usual model is not transport");
  }
  return result->channels[0].R_f32[0];
}

// Asks for the model "classicall", which does not exist, with a tolerance. Returns whether the
// library refuses the query.
bool refuses_unknown(dipole_client *client, const dipole_medium &skin, float radius) {
  dipole_error error;
  dipole_result *result = nullptr;
  const dipole_parameter tolerance{dipole_id(client, DIPOLE_PARAMETER, "tolerance"), 0.1};
  dipole_query query;
  dipole_query_init(&query);
  query.model = dipole_id(client, DIPOLE_MODEL, "classicall");
  query.media = &skin;
  query.medium_count = 1;
  query.radii = &radius;
  query.radius_count = 1;
  query.parameters = &tolerance;
  query.parameter_count = 1;
  const bool refused = !dipole_eval(client, &query, &result, &error);
  query.model = DIPOLE_ANY_MODEL;
  check(dipole_eval(client, &query, &result, refused ? &error : nullptr), error);
  const Owner<dipole_result> owner(result);
  return refused && result->model != 0;
}

float look_up(dipole_client *client, const char *model, const dipole_medium &skin, float radius) {
  dipole_error error;
  dipole_table *table = nullptr;
  dipole_table_query query{};
  query.model = dipole_id(client, DIPOLE_MODEL, model);
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
    const float near = look_up(client.get(), "better", skin, 1.0f);
    const float usual = evaluate_usual(client.get(), skin, 1.0f);
    std::printf("%.9g %.9g %.9g\n", double(R[0]), double(R[1]), double(near));
    return refuses_unknown(client.get(), skin, 1.0f) &&
                   usual == look_up(client.get(), "transport", skin, 1.0f) && R[0] == R[1] &&
                   near > 0.999f * R[0] && near < 1.001f * R[0]
               ? 0
               : 1;
  } catch (const std::exception &failure) {
    std::fprintf(stderr, "%s\n", failure.what());
    return 1;
  }
}
