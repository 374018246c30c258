/* Measures the transport solver on one core.
 *
 *   transport.<medium>.<tolerance>       one medium by itself: boundary and solution             s
 *   transport.albedos64.<tolerance>      64 albedos of one eta                                   s
 *   transport.at                         one radius of a solution: R, its parts, energy, errors  us
 */
#include <stdio.h>
#include <stdlib.h>

#include "core/transport/transport.h"
#include "tests/bench/bench.h"

enum { RUNS = 5, ALBEDOS = 64, RADII = 512 };

static const struct {
  const char *name;
  double eta;
  double albedo;
} media[] = {{"skin", 1.4, 0.95},
             {"white", 1.5, 0.9999},
             {"black", 1.3, 0.1},
             {"thin", 0.8, 0.95},
             {"unbounded", 1, 0.95}};

static transport_solution *solve(transport_boundary *boundary, double albedo) {
  transport_solution *solution;
  if (transport_solve(&solution, boundary, albedo).field != NULL) {
    bench_fail("a medium was refused");
  }
  return solution;
}

static transport_boundary *boundary_for(double eta, double tolerance) {
  transport_boundary *boundary;
  if (transport_boundary_create(&boundary, eta, tolerance).field != NULL) {
    bench_fail("a boundary was refused");
  }
  return boundary;
}

/* Returns the seconds for `count` albedos of one eta, in equal steps from `first` on. */
static double time_s(double eta, double first, int count, double tolerance) {
  const uint64_t start = bench_now_ns();
  transport_boundary *boundary = boundary_for(eta, tolerance);
  for (int i = 0; i < count; i++) {
    transport_solution_free(solve(boundary, first + (1 - first) * i / count));
  }
  transport_boundary_free(boundary);
  return (double)(bench_now_ns() - start) * 1e-9;
}

static void measure(const char *name, double eta, double first, int count, double tolerance) {
  double seconds[RUNS];
  for (int i = 0; i < RUNS; i++) {
    bench_progress(name);
    seconds[i] = time_s(eta, first, count, tolerance);
  }
  bench_figure(bench_median(seconds, RUNS), "s", "transport.%s.%g", name, tolerance);
}

static void measure_evaluation(void) {
  static double us[RADII];
  transport_boundary *boundary = boundary_for(1.4, 1e-5);
  transport_solution *solution = solve(boundary, 0.95);
  double sum = 0;
  for (int i = 0; i < RADII; i++) {
    const uint64_t start = bench_now_ns();
    sum += transport_at(solution, 0.01 * (i + 1)).R.value;
    us[i] = (double)(bench_now_ns() - start) * 1e-3;
  }
  if (!(sum > 0)) {
    bench_fail("a solution has no light");
  }
  bench_figure(bench_median(us, RADII), "us", "transport.at");
  transport_solution_free(solution);
  transport_boundary_free(boundary);
}

void bench_transport(void) {
  static const double tolerances[] = {1e-3, 1e-5, 1e-7, 1e-9};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    for (size_t j = 0; j < sizeof tolerances / sizeof tolerances[0]; j++) {
      measure(media[i].name, media[i].eta, media[i].albedo, 1, tolerances[j]);
    }
  }
  measure("albedos64", 1.4, 0.01, ALBEDOS, 1e-5);
  measure_evaluation();
}
