#include "tests/bench/service/target.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

#include "core/core.h"
#include "proto/eval.h"
#include "proto/varying.h"
#include "tests/bench/bench.h"

/* ---- addresses ---------------------------------------------------------------------------- */

struct target_address target_unix(const char *path) {
  struct target_address address = {.bytes = sizeof(struct sockaddr_un)};
  struct sockaddr_un name = {.sun_family = AF_UNIX};
  snprintf(name.sun_path, sizeof name.sun_path, "%s", path);
  memcpy(&address.name, &name, sizeof name);
  return address;
}

struct target_address target_tcp(unsigned port) {
  struct target_address address = {.bytes = sizeof(struct sockaddr_in)};
  const struct sockaddr_in name = {.sin_family = AF_INET,
                                   .sin_port = htons((uint16_t)port),
                                   .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  memcpy(&address.name, &name, sizeof name);
  return address;
}

int target_listen(struct target_address *address) {
  enum { BACKLOG = 128 };
  const int fd = socket(address->name.ss_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0 || bind(fd, (const struct sockaddr *)&address->name, address->bytes) != 0 ||
      listen(fd, BACKLOG) != 0 ||
      getsockname(fd, (struct sockaddr *)&address->name, &address->bytes) != 0) {
    bench_fail("cannot listen");
  }
  return fd;
}

int target_connect(const struct target_address *address) {
  const int on = 1;
  const struct timeval silence = {.tv_sec = TARGET_SILENCE_S};
  const int fd = socket(address->name.ss_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0 || connect(fd, (const struct sockaddr *)&address->name, address->bytes) != 0 ||
      setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &silence, sizeof silence) != 0 ||
      setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &silence, sizeof silence) != 0) {
    bench_fail("cannot connect to a server");
  }
  if (address->name.ss_family == AF_INET &&
      setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on) != 0) {
    bench_fail("cannot set TCP_NODELAY");
  }
  return fd;
}

/* ---- evaluations -------------------------------------------------------------------------- */

enum {
  SMALL_VARIANTS = 64,
  SMALL_BYTES = 4096,
  CHECK_LARGE_EVERY = 16, /* because a comparison takes a good part of the measured time */
};
static const enum core_model model = CORE_MODEL_BETTER;

/* Fills r with random radii from 0.01 to 10 mm. */
static void fill_radii(float *r, size_t n, uint32_t *random) {
  for (size_t i = 0; i < n; i++) {
    *random = *random * 1664525u + 1013904223u;
    r[i] = 0.01f + 9.99f * (float)(*random >> 8) * 0x1p-24f;
  }
}

/* Returns the medium of a variant: the channels of skin1 in turn. */
static const core_medium *medium_of(size_t variant) {
  return &core_measured_medium_by_name("skin1")->channel[variant % 3];
}

static void put_request(const struct target *target, size_t variant, size_t n, const float *r) {
  uint8_t *at = target->requests + variant * target->request_bytes;
  const core_medium *medium = medium_of(variant);
  const wire_header header = {
      .magic = WIRE_MAGIC,
      .version = WIRE_VERSION,
      .type = WIRE_TYPE_EVAL,
      .payload_bytes = (uint32_t)(target->request_bytes - WIRE_BYTES_header),
  };
  const wire_eval_request fixed = {
      .model = model,
      .evaluator = CORE_EVALUATOR_F32,
      .moments = CORE_MOMENTS_EXACT,
      .wanted = CORE_QUANTITY_R,
      .medium_count = 1,
      .layer_count = 1,
      .spacing = CORE_SPACING_LIST,
      .radius_count = n,
  };
  const wire_medium channel = {medium->sigma_a_per_mm, medium->sigma_s_per_mm, medium->g,
                               medium->eta};
  wire_put_header(at, &header);
  wire_put_eval_request(at + WIRE_BYTES_header, &fixed);
  wire_put_medium(at + WIRE_BYTES_header + WIRE_BYTES_eval_request, &channel);
  memcpy(at + WIRE_BYTES_header + WIRE_BYTES_eval_request + WIRE_BYTES_medium, r, n * sizeof *r);
}

static void put_reply(const struct target *target, size_t variant, size_t n, const float *r) {
  uint8_t *at = target->replies + variant * target->reply_bytes;
  const wire_header header = {
      .magic = WIRE_MAGIC,
      .version = WIRE_VERSION,
      .type = WIRE_TYPE_EVAL | WIRE_REPLY,
      .payload_bytes = (uint32_t)(target->reply_bytes - WIRE_BYTES_header),
  };
  core_profile profile;
  if (core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                           CORE_EVALUATOR_F32, medium_of(variant), NULL)
          .field != NULL) {
    bench_fail("a measured medium was refused");
  }
  wire_put_header(at, &header);
  core_eval_f32(&profile, CORE_QUANTITY_R, n, r, (float *)(at + target->values_from));
  core_profile_free(&profile);
}

static void allocate(struct target *target) {
  target->requests = calloc(target->variants, target->request_bytes);
  target->replies = calloc(target->variants, target->reply_bytes);
  if (target->requests == NULL || target->replies == NULL) {
    bench_fail("out of memory");
  }
}

void target_make_eval(struct target *target, size_t n) {
  const uint64_t bytes = n * sizeof(float);
  eval_layout layout;
  if (!eval_reply_layout(CORE_EVALUATOR_F32, CORE_QUANTITY_R, 1, n, UINT32_MAX, &layout)) {
    bench_fail("too many radii");
  }
  const bool small = bytes <= SMALL_BYTES;
  *target = (struct target){
      .name = "dipoled",
      .variants = small ? SMALL_VARIANTS : 1,
      .request_bytes = WIRE_BYTES_header + WIRE_BYTES_eval_request + WIRE_BYTES_medium +
                       (size_t)wire_padded(bytes),
      .reply_bytes = WIRE_BYTES_header + (size_t)layout.payload_bytes,
      .values_from = WIRE_BYTES_header + (size_t)layout.arrays_offset,
      .check_every = small ? 1 : CHECK_LARGE_EVERY,
  };
  allocate(target);
  float *r = malloc(bytes);
  if (r == NULL) {
    bench_fail("out of memory");
  }
  uint32_t random = 1;
  for (size_t variant = 0; variant < target->variants; variant++) {
    fill_radii(r, n, &random);
    put_request(target, variant, n, r);
    put_reply(target, variant, n, r);
  }
  free(r);
}

/* Fills media and radii with what renderers meet: mean free paths of about a millimetre, and some
 * tenth of the light absorbed. */
static void fill_media(float *sigma_a, float *sigma_s, float *r, size_t n) {
  uint32_t random = 1;
  float *arrays[] = {sigma_a, sigma_s, r};
  const float least[] = {0.001f, 0.5f, 0.05f}, range[] = {0.5f, 2, 3};
  for (size_t i = 0; i < n; i++) {
    for (size_t array = 0; array < 3; array++) {
      random = random * 1664525u + 1013904223u;
      arrays[array][i] = least[array] + range[array] * (float)(random >> 8) * 0x1p-24f;
    }
  }
}

/* Evaluates the request of a target into its reply. */
static void answer_varying(const struct target *target, const core_varying *varying, size_t n) {
  varying_request request;
  varying_part part;
  double *scratch = malloc(VARYING_SCRATCH_ARRAYS * VARYING_SLICE_VALUES * sizeof *scratch);
  const wire_error error = varying_request_parse(
      target->requests + WIRE_BYTES_header, target->request_bytes - WIRE_BYTES_header, &request);
  if (error.status != WIRE_STATUS_OK || scratch == NULL) {
    bench_fail("a request is wrong, or out of memory");
  }
  varying_part_start(&part, &request, target->replies + WIRE_BYTES_header, 0, n);
  for (size_t at = 0; at < n; at += VARYING_SLICE_VALUES) {
    const size_t left = n - at;
    varying_part_evaluate(&part, &request, varying, NULL, at,
                          left < VARYING_SLICE_VALUES ? left : VARYING_SLICE_VALUES, scratch);
  }
  varying_part_end(&part, &request, varying, NULL, 0, 1);
  free(scratch);
}

void target_make_varying(struct target *target, const core_varying *varying, size_t n) {
  const wire_varying_request fixed = {.model = (uint16_t)varying->model,
                                      .evaluator = CORE_EVALUATOR_F32,
                                      .moments = CORE_MOMENTS_EXACT,
                                      .wanted = CORE_QUANTITY_R,
                                      .numbers = VARYING_RADII,
                                      .value_count = n,
                                      .g = varying->g,
                                      .eta = varying->eta};
  const varying_layout layout = varying_reply_layout(CORE_EVALUATOR_F32, CORE_QUANTITY_R, 0, n);
  *target = (struct target){
      .name = "dipoled",
      .variants = 1,
      .request_bytes = WIRE_BYTES_header + (size_t)schema_bytes(&schema_varying_request, &fixed),
      .reply_bytes = WIRE_BYTES_header + (size_t)layout.payload_bytes,
      .values_from = WIRE_BYTES_header + WIRE_BYTES_varying_reply,
      .check_every = CHECK_LARGE_EVERY,
  };
  allocate(target);
  wire_header header = {.magic = WIRE_MAGIC, .version = WIRE_VERSION, .type = WIRE_TYPE_VARYING};
  header.payload_bytes = (uint32_t)(target->request_bytes - WIRE_BYTES_header);
  wire_put_header(target->requests, &header);
  wire_put_varying_request(target->requests + WIRE_BYTES_header, &fixed);
  float *arrays = (float *)(target->requests + WIRE_BYTES_header + WIRE_BYTES_varying_request);
  fill_media(arrays, arrays + n, arrays + 2 * n, n);
  header.type |= WIRE_REPLY;
  header.payload_bytes = (uint32_t)(target->reply_bytes - WIRE_BYTES_header);
  wire_put_header(target->replies, &header);
  answer_varying(target, varying, n);
}

void target_make_echo(struct target *target, const struct target *eval) {
  *target = *eval;
  target->name = "echo";
  allocate(target);
  memcpy(target->requests, eval->requests, target->variants * target->request_bytes);
  for (size_t variant = 0; variant < target->variants; variant++) {
    memcpy(target->replies + variant * target->reply_bytes, eval->replies, target->reply_bytes);
  }
}

void target_free(struct target *target) {
  free(target->requests);
  free(target->replies);
}

/* ---- frames ------------------------------------------------------------------------------- */

/* The offset of the request id in a header, see proto/PROTOCOL.md. The id comes back as it was
 * sent, so its byte order does not matter. */
enum { ID_OFFSET = 8, ID_END = 16 };

void target_set_id(uint8_t *request, uint64_t id) {
  memcpy(request + ID_OFFSET, &id, sizeof id);
}

uint64_t target_id(const uint8_t *reply) {
  uint64_t id;
  memcpy(&id, reply + ID_OFFSET, sizeof id);
  return id;
}

static _Noreturn void wrong(const struct target *target, const uint8_t *reply, const char *why) {
  wire_header header;
  wire_get_header(reply, &header);
  fprintf(stderr, "bench: %s: %s\n", target->name, why);
  if (header.magic == WIRE_MAGIC && header.type == WIRE_TYPE_ERROR) {
    wire_error error;
    wire_get_error(reply + WIRE_BYTES_header, &error);
    fprintf(stderr, "bench: it says %s, field %s: %s\n", wire_status_name(error.status),
            error.field, error.allowed);
  }
  bench_fail("a wrong answer");
}

static bool header_is_right(const uint8_t *expected, uint64_t id, const uint8_t *reply) {
  return memcmp(reply, expected, ID_OFFSET) == 0 && target_id(reply) == id &&
         memcmp(reply + ID_END, expected + ID_END, WIRE_BYTES_header - ID_END) == 0;
}

void target_check(const struct target *target, size_t variant, uint64_t id, const uint8_t *reply,
                  bool values) {
  const uint8_t *expected = target->replies + variant * target->reply_bytes;
  if (!header_is_right(expected, id, reply)) {
    wrong(target, reply, "a reply has another header than it should have");
  }
  if (values && memcmp(reply + target->values_from, expected + target->values_from,
                       target->reply_bytes - target->values_from) != 0) {
    wrong(target, reply, "a reply has other values than it should have");
  }
}
