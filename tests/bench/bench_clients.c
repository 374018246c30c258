/* Compares the Python client with libdipole: a query for R of skin1's three channels by the better
 * dipole, at a million listed radii, over a Unix socket to one daemon. Both clients ask in turn.
 * The time is that of the call in the client's own process, until the answer is an array. The last
 * values of both answers are compared.
 *
 *   clients.<evaluator>.<c or python>    the median time of a call                        ms
 *   ratio.clients.python.<evaluator>     Python's over C's, the median of the rounds' ratios
 *
 * Start it at the top of the repository, where it finds the Python module.
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/c/dipole.h"
#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"
#include "tests/bench/service/daemon.h"

enum { RADII = 1000000, CHANNELS = 3, ROUNDS = 21, WARM_UP = 3, LIMIT_S = 120 };
#define START_MM 0.01
#define STEP_MM 2e-5
#define PYTHON "/usr/bin/python3"
#define SCRIPT "tests/bench/clients_python.py"

/* The process that runs the script. It gets one line, and answers with one line, for each call. */
struct python {
  pid_t child;
  FILE *to;
  FILE *from;
};

struct call {
  double ms;
  double last; /* the last value of the answer */
};

static struct python start_python(const char *address) {
  int to[2], from[2];
  if (access(SCRIPT, R_OK) != 0 || access(PYTHON, X_OK) != 0) {
    bench_fail("there is no " SCRIPT " here, or no " PYTHON ": start it at the repository's top");
  }
  if (pipe(to) != 0 || pipe(from) != 0) {
    bench_fail("no pipes");
  }
  struct python python = {.child = child_fork(CHILD_CLIENT)};
  if (python.child == 0) {
    char count[32], start[32], step[32];
    snprintf(count, sizeof count, "%d", RADII);
    snprintf(start, sizeof start, "%.17g", START_MM);
    snprintf(step, sizeof step, "%.17g", STEP_MM);
    dup2(to[0], STDIN_FILENO);
    dup2(from[1], STDOUT_FILENO);
    close(to[1]); /* so that the process sees the end of its input */
    execl(PYTHON, PYTHON, SCRIPT, address, count, start, step, (char *)NULL);
    _exit(EXIT_FAILURE);
  }
  close(to[0]);
  close(from[1]);
  python.to = fdopen(to[1], "w");
  python.from = fdopen(from[0], "r");
  return python;
}

static void end_python(struct python *python) {
  fclose(python->to);
  fclose(python->from);
  child_end(python->child);
}

static struct call ask_python(struct python *python, const char *evaluator) {
  struct call call = {0};
  uint64_t ns = 0;
  fprintf(python->to, "%s\n", evaluator);
  fflush(python->to);
  if (fscanf(python->from, "%" SCNu64 " %la", &ns, &call.last) != 2) {
    bench_fail("the Python side has failed: is numpy installed?");
  }
  call.ms = (double)ns * 1e-6;
  return call;
}

static struct call ask_c(dipole_client *client, const dipole_query *query) {
  struct call call;
  dipole_error error;
  dipole_result *result;
  const uint64_t start_ns = bench_now_ns();
  if (!dipole_eval(client, query, &result, &error)) {
    bench_fail(error.text);
  }
  call.ms = (double)(bench_now_ns() - start_ns) * 1e-6;
  const dipole_channel *last = &result->channels[CHANNELS - 1];
  call.last = last->R_f64 != NULL ? last->R_f64[RADII - 1] : (double)last->R_f32[RADII - 1];
  dipole_result_free(result);
  return call;
}

static void measure(dipole_client *client, struct python *python, const dipole_query *query,
                    const char *evaluator) {
  double c_ms[ROUNDS], python_ms[ROUNDS], ratios[ROUNDS];
  for (int round = -WARM_UP; round < ROUNDS; round++) {
    const struct call c = ask_c(client, query);
    const struct call other = ask_python(python, evaluator);
    if (c.last != other.last) {
      bench_fail("the two clients have got different values");
    }
    if (round >= 0) {
      c_ms[round] = c.ms;
      python_ms[round] = other.ms;
      ratios[round] = other.ms / c.ms;
    }
  }
  bench_figure(bench_median(c_ms, ROUNDS), "ms", "clients.%s.c", evaluator);
  bench_figure(bench_median(python_ms, ROUNDS), "ms", "clients.%s.python", evaluator);
  bench_figure(bench_median(ratios, ROUNDS), "times", "ratio.clients.python.%s", evaluator);
}

static dipole_client *open_client(const char *address) {
  dipole_client *client;
  dipole_error error;
  if (!dipole_open(address, &client, &error)) {
    bench_fail(error.text);
  }
  return client;
}

/* Finds the three media of skin1 in the daemon's list. */
static void find_media(dipole_client *client, dipole_medium *media) {
  dipole_measured_medium *measured;
  size_t count;
  dipole_error error;
  if (!dipole_media(client, &measured, &count, &error)) {
    bench_fail(error.text);
  }
  for (size_t i = 0; i < count; i++) {
    if (strcmp(measured[i].name, "skin1") == 0) {
      memcpy(media, measured[i].channel, CHANNELS * sizeof *media);
      free(measured);
      return;
    }
  }
  bench_fail("the daemon does not know skin1");
}

void bench_clients(void) {
  struct daemon daemon;
  char address[128];
  child_begin(LIMIT_S);
  bench_progress("clients: C and Python");
  daemon_start(&daemon, CHILD_SERVER, "clients", 1);
  snprintf(address, sizeof address, "unix:%s", child_path("clients"));
  child_pin(CHILD_CLIENT);
  dipole_client *client = open_client(address);
  struct python python = start_python(address);

  double *r_f64 = malloc(RADII * sizeof *r_f64);
  float *r_f32 = malloc(RADII * sizeof *r_f32);
  if (r_f64 == NULL || r_f32 == NULL) {
    bench_fail("out of memory");
  }
  for (size_t i = 0; i < RADII; i++) {
    r_f64[i] = START_MM + STEP_MM * (double)i;
    r_f32[i] = (float)r_f64[i];
  }
  dipole_medium media[CHANNELS];
  find_media(client, media);
  dipole_query query = {.model = dipole_id(client, DIPOLE_MODEL, "better"),
                        .evaluator = DIPOLE_F64,
                        .moments = DIPOLE_EXACT,
                        .wanted = DIPOLE_R,
                        .media = media,
                        .medium_count = CHANNELS,
                        .spacing = DIPOLE_LIST,
                        .radii = r_f64,
                        .radius_count = RADII};
  measure(client, &python, &query, "f64");
  query.evaluator = DIPOLE_F32;
  query.radii = r_f32;
  measure(client, &python, &query, "f32");

  free(r_f64);
  free(r_f32);
  end_python(&python);
  dipole_close(client);
  daemon_end(&daemon);
  child_end_all();
}
