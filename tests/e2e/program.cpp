// A C++ program that uses libdipole: each kind of call once. Prints R at 1 mm as it came in each
// way, and R of a query whose media vary; exits with 1 when they differ, when what is evaluated at
// home has other bits than the daemon's, or when the unknown model of a query is not refused.
#include <dipole.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <vector>

namespace {

struct Closer {
  void operator()(dipole_client *client) const { dipole_close(client); }
  void operator()(dipole_result *result) const { dipole_result_free(result); }
  void operator()(dipole_table *table) const { dipole_table_free(table); }
  void operator()(dipole_surface *surface) const { dipole_surface_free(surface); }
  void operator()(dipole_varying_result *result) const { dipole_varying_result_free(result); }
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

// Media, colours, lengths, radii and numbers u of all magnitudes, some of which are wrong.
template <typename T> struct Numbers {
  std::vector<T> sigma_a, sigma_s, colour, radius, u;
  explicit Numbers(int count) {
    for (int i = 0; i < count; i++) {
      const double share = (i * 619 % count + 0.5) / count, other = (i * 31 % count + 0.5) / count;
      sigma_a.push_back(T(i % 97 == 96 ? -1 : std::pow(10, -5 + 5 * share)));
      sigma_s.push_back(T(std::pow(10, -1 + 3 * other)));
      colour.push_back(T(i % 89 == 88 ? 2 : share));
      radius.push_back(T(i % 83 == 82 ? NAN : std::pow(10, -3 + 5 * share)));
      u.push_back(T(i % 79 == 78 ? -0.1 : other));
    }
    sigma_a[0] = T(0.125), sigma_s[0] = T(9), radius[0] = T(0.5);
  }
};

const void *array_of(const dipole_varying_result *result, bool coefficient, unsigned bit) {
  if (result->evaluator == DIPOLE_F64) {
    return coefficient ? dipole_coefficients_f64(result, bit) : dipole_varying_f64(result, bit);
  }
  return coefficient ? static_cast<const void *>(dipole_coefficients_f32(result, bit))
                     : dipole_varying_f32(result, bit);
}

// Returns whether two results have the same bits in all arrays, statuses and facts.
bool is_same(const dipole_varying_result *a, const dipole_varying_result *b) {
  const std::size_t count = a->value_count;
  const std::size_t bytes = count * (a->evaluator == DIPOLE_F64 ? sizeof(double) : sizeof(float));
  const auto same = [](double x, double y) { return std::memcmp(&x, &y, sizeof x) == 0; };
  bool good = count == b->value_count && a->answered_count == b->answered_count &&
              a->notes == b->notes && same(a->numerical_error, b->numerical_error) &&
              same(a->model_error, b->model_error) && same(a->colour_least, b->colour_least) &&
              same(a->colour_most, b->colour_most) && same(a->specular, b->specular) &&
              std::memcmp(a->statuses, b->statuses, count) == 0;
  for (unsigned bit = 1; bit <= DIPOLE_BY_SIGMA_S; bit *= 2) {
    for (const bool coefficient : {false, true}) {
      const void *x = array_of(a, coefficient, bit), *y = array_of(b, coefficient, bit);
      const bool wanted = ((coefficient ? a->coefficients : a->wanted) & bit) != 0;
      good = good && (x != nullptr) == wanted && (y != nullptr) == wanted &&
             (!wanted || std::memcmp(x, y, bytes) == 0);
    }
  }
  return good;
}

// Evaluates a query at home and by the daemon. Returns the answer if both have the same bits.
Owner<dipole_varying_result> ask_both(dipole_client *client, const dipole_surface *surface,
                                      const dipole_varying_query &query) {
  dipole_error error;
  dipole_varying_result *asked = nullptr, *home = nullptr;
  check(dipole_varying(client, &query, &asked, &error), error);
  Owner<dipole_varying_result> first(asked);
  check(dipole_varying_at_home(surface, &query, &home, &error), error);
  const Owner<dipole_varying_result> second(home);
  if (!is_same(asked, home) || asked->answered_count < asked->value_count / 2 ||
      asked->answered_count == asked->value_count) {
    throw std::runtime_error("what was evaluated at home is not the daemon's answer");
  }
  return first;
}

// Asks for media by coefficients and by colours, and for radii by numbers u. Returns the first R.
template <typename T>
double vary(dipole_client *client, const dipole_surface *surface, unsigned evaluator) {
  const int count = 5000; // in more than one slice
  const Numbers<T> numbers(count);
  dipole_varying_query query{};
  query.model = dipole_id(client, DIPOLE_MODEL, "transport");
  query.evaluator = evaluator;
  query.moments = DIPOLE_EXACT;
  query.wanted = DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF | DIPOLE_PDF | DIPOLE_RING;
  query.coefficients = DIPOLE_SIGMA_A | DIPOLE_SIGMA_S | DIPOLE_SCATTERED;
  query.g = 0.8;
  query.eta = 1.4;
  query.sigma_a_per_mm = numbers.sigma_a.data();
  query.sigma_s_per_mm = numbers.sigma_s.data();
  query.radii = numbers.radius.data();
  query.value_count = count;
  const Owner<dipole_varying_result> given = ask_both(client, surface, query);
  query.radii = nullptr;
  query.numbers = numbers.u.data();
  query.wanted |= DIPOLE_RADIUS;
  ask_both(client, surface, query);
  query.sigma_a_per_mm = query.sigma_s_per_mm = query.numbers = nullptr;
  query.colours = numbers.colour.data();
  query.lengths_mm = numbers.sigma_s.data();
  query.given = DIPOLE_MEAN_FREE_PATH;
  query.wanted = DIPOLE_ALBEDO;
  for (const unsigned light : {DIPOLE_BEAM, DIPOLE_DIFFUSE}) {
    query.light = light;
    query.specular = light == DIPOLE_DIFFUSE;
    ask_both(client, surface, query);
  }
  return double(static_cast<const T *>(array_of(given.get(), false, DIPOLE_R))[0]);
}

double vary_at_home(dipole_client *client) {
  dipole_error error;
  dipole_surface *surface = nullptr;
  dipole_table_query query{};
  query.model = dipole_id(client, DIPOLE_MODEL, "transport");
  query.moments = DIPOLE_EXACT;
  query.medium = {0, 0, 0.8, 1.4};
  check(dipole_surface_fetch(client, &query, &surface, &error), error);
  const Owner<dipole_surface> fetched(surface);
  std::size_t count = 0;
  const void *bytes = dipole_surface_bytes(surface, &count);
  check(dipole_surface_load(bytes, count, &surface, &error), error);
  const Owner<dipole_surface> loaded(surface);
  vary<float>(client, fetched.get(), DIPOLE_F32);
  return vary<double>(client, loaded.get(), DIPOLE_F64);
}

} // namespace

int main(int argc, char **argv) {
  try {
    const Owner<dipole_client> client = open(argc > 1 ? argv[1] : nullptr);
    const dipole_medium skin{0.032, 0.74, 0, 1.3};
    const std::vector<float> R = evaluate(client.get(), skin, 1.0f);
    const float near = look_up(client.get(), "better", skin, 1.0f);
    const float usual = evaluate_usual(client.get(), skin, 1.0f);
    const double varying = vary_at_home(client.get());
    std::printf("%.9g %.9g %.9g %.17g\n", double(R[0]), double(R[1]), double(near), varying);
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
