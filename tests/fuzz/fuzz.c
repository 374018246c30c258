/* fuzz: the functions that libFuzzer calls with arbitrary bytes. `fuzz_targets` lists them. The
 * variable FUZZ_TARGET names the target that this process runs; without it, the process prints the
 * names and exits with 2:
 *
 *   FUZZ_TARGET=modbus build-fuzz/fuzz build-fuzz/corpus/modbus     searches
 *   FUZZ_TARGET=modbus build-fuzz/fuzz FILE                         runs one input again
 *
 * tests/fuzz/fuzz.py runs all targets. Besides the checks of the sanitizers, each target checks the
 * properties that must hold for any bytes, and aborts if one does not. */
#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <math.h>
#include <modbus.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include "clients/c/address.h"
#include "clients/c/info.h"
#include "clients/c/request.h"
#include "clients/cli/csv.h"
#include "clients/cli/number.h"
#include "core/lut/lut.h"
#include "proto/channels.h"
#include "proto/invert.h"
#include "proto/mc.h"
#include "proto/sample.h"
#include "proto/table.h"
#include "server/jobs/mc_pool.h"
#include "server/jobs/requests.h"
#include "server/modbus/access.h"
#include "server/modbus/connection.h"
#include "server/modbus/diagnostics.h"
#include "server/modbus/receiver.h"
#include "server/net/connection.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#define CHECK(condition)                                                                           \
  ((condition) ? (void)0 : fail_check(__FILE__ ":" FUZZ_TEXT(__LINE__) ": " #condition "\n"))
#define FUZZ_TEXT(x) FUZZ_TEXT_OF(x)
#define FUZZ_TEXT_OF(x) #x

static _Noreturn void fail_check(const char *text) {
  (void)!write(STDERR_FILENO, text, strlen(text));
  abort();
}

/* ---- inputs --------------------------------------------------------------------------------- */

/* Returns a copy in a block of exactly its size, at a multiple of 8, so that a sanitizer sees each
 * read past its end. The caller frees it. */
static uint8_t *exact_copy(const uint8_t *data, size_t size) {
  uint8_t *copy = malloc(size > 0 ? size : 1);
  CHECK(copy != NULL);
  memcpy(copy, data, size);
  return copy;
}

/* How the bytes of an input are delivered, which its first bytes say. */
struct delivery {
  unsigned piece; /* 0: all at once; else pieces of 1 to this many bytes */
  uint32_t random;
  const uint8_t *at;
  size_t left;
};

static struct delivery begin_delivery(const uint8_t *data, size_t size) {
  return (struct delivery){.piece = data[0], .random = data[0], .at = data + 1, .left = size - 1};
}

/* Sets *piece to the next piece and returns its length, which is 0 at the end. */
static size_t next_piece(struct delivery *delivery, const uint8_t **piece) {
  size_t bytes = delivery->left;
  if (delivery->piece > 0) {
    delivery->random = delivery->random * 1664525 + 1013904223;
    const size_t wanted = 1 + (delivery->random >> 16) % delivery->piece;
    bytes = wanted < bytes ? wanted : bytes;
  }
  *piece = delivery->at;
  delivery->at += bytes;
  delivery->left -= bytes;
  return bytes;
}

/* A buffer that gathers bytes. */
struct gathered {
  uint8_t *bytes;
  size_t count;
  size_t room;
};

static uint8_t *gather_room(struct gathered *gathered, size_t bytes) {
  if (gathered->room - gathered->count < bytes) {
    gathered->room = 2 * gathered->room + bytes;
    gathered->bytes = realloc(gathered->bytes, gathered->room);
    CHECK(gathered->bytes != NULL);
  }
  return gathered->bytes + gathered->count;
}

/* ---- messages: payloads are decoded, and what was decoded is encoded ------------------------- */

/* A structure that is read from any bytes, written and read again is the same. */
#define WIRE_STRUCTURE(name, about)                                                                \
  static void round_trip_##name(const uint8_t *data) {                                             \
    uint8_t once[WIRE_BYTES_##name], twice[WIRE_BYTES_##name];                                     \
    wire_##name structure;                                                                         \
    wire_get_##name(data, &structure);                                                             \
    wire_put_##name(once, &structure);                                                             \
    wire_get_##name(once, &structure);                                                             \
    wire_put_##name(twice, &structure);                                                            \
    CHECK(memcmp(once, twice, sizeof once) == 0);                                                  \
  }
#include "proto/messages.def"

static void round_trips(const uint8_t *data, size_t size) {
#define WIRE_STRUCTURE(name, about)                                                                \
  if (size >= WIRE_BYTES_##name) {                                                                 \
    uint8_t *copy = exact_copy(data, WIRE_BYTES_##name);                                           \
    round_trip_##name(copy);                                                                       \
    free(copy);                                                                                    \
  }
#include "proto/messages.def"
}

static bool is_good(const wire_error *error) {
  if (error->status == WIRE_STATUS_OK) {
    return true;
  }
  CHECK(error->status == WIRE_STATUS_BAD_LENGTH || error->status == WIRE_STATUS_BAD_COUNT ||
        error->status == WIRE_STATUS_BAD_VALUE);
  CHECK(error->field[0] != '\0' && error->allowed[0] != '\0');
  return false;
}

/* Reads all bytes of an array, and checks that it lies in the payload. */
static void read_array(const uint8_t *payload, size_t size, uint64_t offset, uint64_t bytes) {
  CHECK(offset <= size && bytes <= size - offset);
  free(exact_copy(payload + offset, (size_t)bytes));
}

/* Encodes and decodes parameters once more, and checks that they are the same. */
static void check_parameters(const core_parameters *parameters, uint32_t count) {
  uint8_t bytes[CORE_PARAMETERS_END * WIRE_BYTES_parameter];
  core_parameters again;
  CHECK(channels_count_parameters(parameters) == count);
  CHECK(channels_put_parameters(bytes, parameters) == count * (size_t)WIRE_BYTES_parameter);
  CHECK(channels_parse_parameters(bytes, count, &again).status == WIRE_STATUS_OK);
  CHECK(memcmp(again.value, parameters->value, sizeof again.value) == 0);
}

static void check_lists(const eval_request *request, const uint8_t *payload, size_t size,
                        uint64_t listed) {
  const uint64_t value_bytes = core_evaluator_bytes(request->fixed.evaluator);
  CHECK(value_bytes == 4 || value_bytes == 8);
  read_array(payload, size, (uint64_t)(request->media - payload),
             request->fixed.medium_count * (uint64_t)WIRE_BYTES_medium);
  CHECK((request->radii != NULL) == (listed > 0 || request->radii != NULL));
  if (listed > 0) {
    read_array(payload, size, (uint64_t)((const uint8_t *)request->radii - payload),
               listed * value_bytes);
  }
  check_parameters(&request->parameters, request->fixed.parameter_count);
}

static void decode_eval(const uint8_t *payload, size_t size) {
  eval_request request;
  const wire_error error = eval_request_parse(payload, size, &request);
  if (is_good(&error)) {
    const wire_eval_request *fixed = &request.fixed;
    const uint64_t listed = fixed->spacing == CORE_SPACING_LIST ? fixed->radius_count : 0;
    check_lists(&request, payload, size, listed);
    CHECK(eval_request_bytes(fixed->medium_count, fixed->parameter_count,
                             listed * core_evaluator_bytes(fixed->evaluator)) == size);
    uint8_t again[WIRE_BYTES_eval_request];
    wire_put_eval_request(again, fixed);
    CHECK(memcmp(again, payload, sizeof again) == 0);
  }
}

static void decode_sample(const uint8_t *payload, size_t size) {
  core_draw draw;
  eval_request request;
  const wire_error error = sample_request_parse(payload, size, &draw, &request);
  if (is_good(&error)) {
    const uint64_t listed = draw.rule == CORE_DRAW_LIST ? draw.count : 0;
    check_lists(&request, payload, size, listed);
    CHECK(sample_request_bytes(request.fixed.medium_count, request.fixed.parameter_count,
                               listed * core_evaluator_bytes(request.fixed.evaluator)) == size);
  }
}

static void decode_invert(const uint8_t *payload, size_t size) {
  invert_request request;
  const wire_error error = invert_request_parse(payload, size, &request);
  if (is_good(&error)) {
    const uint64_t bytes = request.fixed.medium_count * sizeof(double);
    read_array(payload, size, (uint64_t)((const uint8_t *)request.albedos - payload), bytes);
    read_array(payload, size, (uint64_t)((const uint8_t *)request.lengths - payload), bytes);
    CHECK(invert_request_bytes(request.fixed.medium_count) == size);
  }
}

static void decode_mc(const uint8_t *payload, size_t size) {
  mc_request request;
  const wire_error error = mc_request_parse(payload, size, &request);
  if (is_good(&error)) {
    CHECK(request.fixed.albedo_count <= CORE_MC_ALBEDOS_MAX);
    CHECK(mc_request_bytes(request.fixed.albedo_count,
                           channels_count_parameters(&request.parameters)) == size);
  }
}

static void decode_table(const uint8_t *payload, size_t size) {
  table_request request;
  const wire_error error = table_request_parse(payload, size, &request);
  if (is_good(&error)) {
    check_parameters(&request.parameters, request.fixed.parameter_count);
    CHECK(table_request_bytes(request.fixed.parameter_count) == size);
  }
}

/* Checks that values are what their quantity can be: not NaN, not negative unless they are ln R or
 * dR/dr, and a cdf is at most 1. */
static void check_values(const uint8_t *values, uint64_t count, unsigned evaluator,
                         unsigned quantity) {
  const bool any_sign = quantity == CORE_QUANTITY_LN_R || quantity == CORE_QUANTITY_SLOPE;
  for (uint64_t i = 0; i < count; i++) {
    double value;
    if (evaluator == CORE_EVALUATOR_F64) {
      memcpy(&value, values + i * sizeof value, sizeof value);
    } else {
      float single;
      memcpy(&single, values + i * sizeof single, sizeof single);
      value = single;
    }
    CHECK(any_sign ? value == value : value >= 0);
    CHECK(quantity != CORE_QUANTITY_CDF || value <= 1);
  }
}

/* Checks the albedo of a channel. It may exceed 1 for a published model, if the notes say so. */
static void check_albedo(const wire_eval_reply *fixed, const uint8_t *at) {
  wire_channel channel;
  wire_get_channel(at, &channel);
  CHECK(!(fixed->wanted & CORE_QUANTITY_ALBEDO) ||
        (channel.albedo >= 0 && (fixed->notes & CORE_NOTE_ALBEDO_ABOVE_1 ||
                                 channel.albedo <= 1 + channel.numerical_error)));
}

/* Decodes the reply to an eval or sample, and checks it. honest: whether it is the daemon's, so
 * that its values must be valid, too. */
static bool decode_eval_reply(const uint8_t *payload, size_t size, bool drawn, bool honest) {
  wire_eval_reply fixed;
  eval_layout layout;
  if (!eval_reply_parse(payload, size, drawn, &fixed, &layout)) {
    return false;
  }
  const unsigned wanted = fixed.wanted | (drawn ? EVAL_DRAWN : 0);
  CHECK(layout.payload_bytes == size && fixed.part < fixed.part_count);
  for (uint32_t i = 0; i < fixed.channel_count; i++) {
    read_array(payload, size, layout.channels_offset + i * (uint64_t)WIRE_BYTES_channel,
               WIRE_BYTES_channel);
    if (honest) {
      check_albedo(&fixed, payload + layout.channels_offset + i * (size_t)WIRE_BYTES_channel);
    }
    for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
      if (eval_is_array(wanted, quantity->id)) {
        const uint64_t at = eval_array_offset(&layout, wanted, i, (enum core_quantity)quantity->id);
        read_array(payload, size, at, layout.array_bytes);
        if (honest) {
          check_values(payload + at, fixed.radius_count, fixed.evaluator, quantity->id);
        }
      }
    }
  }
  if (!drawn && fixed.wanted & CORE_QUANTITY_RADIUS) {
    read_array(payload, size, layout.radius_offset, layout.array_bytes);
  }
  return true;
}

static bool decode_invert_reply(const uint8_t *payload, size_t size) {
  wire_invert_reply fixed;
  const bool good = invert_reply_parse(payload, size, &fixed);
  for (int array = 0; good && array < INVERT_ARRAYS; array++) {
    read_array(payload, size, invert_array_offset((enum invert_array)array, fixed.medium_count),
               fixed.medium_count * sizeof(double));
  }
  return good;
}

static bool decode_mc_reply(const uint8_t *payload, size_t size, bool *under_way) {
  wire_mc_reply fixed;
  mc_layout layout;
  if (!mc_reply_parse(payload, size, &fixed, &layout)) {
    return false;
  }
  *under_way = fixed.state == MC_UNDER_WAY;
  if (!*under_way) {
    CHECK(layout.payload_bytes == size);
    for (uint32_t side = 0; side < fixed.side_count; side++) {
      read_array(payload, size, mc_photons_offset(&layout, fixed.ring_count, side),
                 fixed.ring_count * sizeof(uint64_t));
      for (uint32_t i = 0; i < 2 * fixed.albedo_count; i++) {
        read_array(payload, size,
                   mc_rings_offset(&layout, fixed.side_count, fixed.ring_count, i / 2, side, i % 2),
                   fixed.ring_count * sizeof(double));
      }
    }
  }
  return true;
}

static void decode_table_reply(const uint8_t *payload, size_t size) {
  wire_table_reply fixed;
  core_parameters parameters;
  const float *words;
  if (table_reply_parse(payload, size, &fixed, &parameters, &words)) {
    check_parameters(&parameters, fixed.parameter_count);
    read_array(payload, size, (uint64_t)((const uint8_t *)words - payload),
               fixed.word_count * sizeof *words);
  }
}

/* The target for messages. An input is the type of a message, in two bytes, and a payload. */
static void messages(const uint8_t *data, size_t size) {
  bool under_way;
  if (size < 2) {
    return;
  }
  const unsigned type = data[0] | (unsigned)data[1] << 8;
  size -= 2;
  uint8_t *payload = exact_copy(data + 2, size);
  round_trips(payload, size);
  switch (type) {
  case WIRE_TYPE_EVAL:
  case WIRE_TYPE_OFFERS:
    decode_eval(payload, size);
    break;
  case WIRE_TYPE_SAMPLE:
    decode_sample(payload, size);
    break;
  case WIRE_TYPE_INVERT:
    decode_invert(payload, size);
    break;
  case WIRE_TYPE_MC:
    decode_mc(payload, size);
    break;
  case WIRE_TYPE_TABLE:
    decode_table(payload, size);
    break;
  case WIRE_TYPE_EVAL | WIRE_REPLY:
    decode_eval_reply(payload, size, false, false);
    break;
  case WIRE_TYPE_SAMPLE | WIRE_REPLY:
    decode_eval_reply(payload, size, true, false);
    break;
  case WIRE_TYPE_INVERT | WIRE_REPLY:
    decode_invert_reply(payload, size);
    break;
  case WIRE_TYPE_MC | WIRE_REPLY:
    decode_mc_reply(payload, size, &under_way);
    break;
  case WIRE_TYPE_TABLE | WIRE_REPLY:
    decode_table_reply(payload, size);
    break;
  default:
    break;
  }
  free(payload);
}

/* ---- the daemon in this process: one worker, whose loop this thread runs ----------------------
 */

static struct server server;
static struct worker worker;
static struct modbus_units *units;

static void start_daemon(void) {
  char *arguments[] = {"dipoled", "--max-frame-bytes", "65536",  "--max-part-bytes",
                       "4096",    "--max-radii",       "20000",  "--max-media",
                       "16",      "--max-mc-photons",  "64",     "--max-mc-jobs",
                       "1024",    "--mc-threads",      "1",      "--workers",
                       "1",       "--cache-bytes",     "1000000"};
  CHECK(options_read((int)(sizeof arguments / sizeof *arguments), arguments, &server.options) ==
        OPTIONS_RUN);
  signal(SIGPIPE, SIG_IGN); /* as the daemon does */
  log_set_level(LOG_LEVEL_ERROR);
  server.isa = core_isa_select(NULL);
  server.workers = &worker;
  server.latencies = calloc(1, sizeof *server.latencies);
  server.cache = cache_new(server.isa, server.options.cache_bytes,
                           server.options.max_waiting_profiles, &server.stats);
  server.mc = mc_pool_new(&server);
  CHECK(worker_open(&worker, &server) == 0);
  stats_claim(1);
}

static void start_modbus(void) {
  start_daemon();
  units = modbus_units_new(&server);
  worker_give(&worker, &units->client);
  uv_run(&worker.loop, UV_RUN_NOWAIT);
}

/* ---- requests of the binary protocol ----------------------------------------------------------
 */

/* The time of all slow requests so far. Some profiles take a second to prepare under the
 * sanitizers, so requests for them get a tenth of the time; the first one always runs. */
static uint64_t slow_ns;

static bool names_slow_profile(unsigned type, const uint8_t *payload, size_t size) {
  eval_request eval = {.fixed = {.model = CORE_MODEL_CLASSICAL, .evaluator = CORE_EVALUATOR_F64}};
  core_draw draw;
  if (type == WIRE_TYPE_EVAL && size >= WIRE_BYTES_eval_request) {
    wire_get_eval_request(payload, &eval.fixed);
  } else if (type == WIRE_TYPE_SAMPLE) {
    sample_request_parse(payload, size, &draw, &eval);
  } else if (type == WIRE_TYPE_INVERT && size >= WIRE_BYTES_invert_request) {
    wire_invert_request invert;
    wire_get_invert_request(payload, &invert);
    eval.fixed.model = invert.model;
  }
  return type == WIRE_TYPE_TABLE || eval.fixed.model == EVAL_ANY_MODEL ||
         core_prepares_slowly(eval.fixed.model, eval.fixed.evaluator);
}

/* The number of answers to a stream: one for each whole frame, each refused header, and an
 * incomplete frame at the end. After a wrong magic number, Monte Carlo jobs may end without an
 * answer. */
struct expected {
  size_t least;
  size_t most;
  bool slow; /* whether a request may take long */
};

static struct expected expect_answers(const uint8_t *at, size_t left) {
  size_t count = 0, jobs = 0;
  bool slow = false;
  while (left >= WIRE_BYTES_header) {
    wire_header header;
    wire_get_header(at, &header);
    if (header.magic != WIRE_MAGIC) {
      return (struct expected){count + 1 - jobs, count + 1, slow};
    }
    const bool good = wire_header_is_good(&header, server.options.max_frame_bytes);
    left -= WIRE_BYTES_header;
    at += WIRE_BYTES_header;
    count += !good;
    if (header.payload_bytes > left) {
      return (struct expected){count + 1, count + 1, slow};
    }
    count += good;
    jobs += good && header.type == WIRE_TYPE_MC;
    slow |= good && names_slow_profile(header.type, at, header.payload_bytes);
    at += header.payload_bytes;
    left -= header.payload_bytes;
  }
  count += left > 0;
  return (struct expected){count, count, slow};
}

/* Checks that the parts of an answer follow each other. An error may end it. */
static bool check_part(uint32_t part, uint32_t part_count, uint32_t *next_part) {
  CHECK(part == *next_part || part == 0);
  *next_part = part + 1 < part_count ? part + 1 : 0;
  return *next_part == 0;
}

/* Checks one frame of an answer. Returns whether it is the last one for its request. */
static bool check_answer(const wire_header *header, const uint8_t *payload, size_t size,
                         uint32_t *next_part) {
  bool under_way = false;
  switch (header->type) {
  case WIRE_TYPE_ERROR: {
    wire_error error;
    CHECK(size == WIRE_BYTES_error);
    wire_get_error(payload, &error);
    CHECK(error.status != WIRE_STATUS_OK && strcmp(wire_status_name(error.status), "unknown") != 0);
    CHECK(error.allowed[0] != '\0');
    return true;
  }
  case WIRE_TYPE_EVAL | WIRE_REPLY:
  case WIRE_TYPE_SAMPLE | WIRE_REPLY: {
    wire_eval_reply fixed;
    CHECK(decode_eval_reply(payload, size, header->type == (WIRE_TYPE_SAMPLE | WIRE_REPLY), true));
    wire_get_eval_reply(payload, &fixed);
    return check_part(fixed.part, fixed.part_count, next_part);
  }
  case WIRE_TYPE_INVERT | WIRE_REPLY: {
    wire_invert_reply fixed;
    CHECK(decode_invert_reply(payload, size));
    wire_get_invert_reply(payload, &fixed);
    return check_part(fixed.part, fixed.part_count, next_part);
  }
  case WIRE_TYPE_MC | WIRE_REPLY:
    CHECK(decode_mc_reply(payload, size, &under_way));
    return !under_way;
  default:
    CHECK(header->type & WIRE_REPLY && strcmp(wire_type_name(header->type), "unknown") != 0);
    return true;
  }
}

/* Checks all answers to a stream. Returns how many requests they have answered completely. */
static size_t check_answers(const struct gathered *answers, bool may_be_cut) {
  size_t done = 0, last = 0;
  uint32_t next_part = 0;
  while (answers->count - done >= WIRE_BYTES_header) {
    wire_header header;
    wire_get_header(answers->bytes + done, &header);
    CHECK(wire_header_is_good(&header, server.options.max_frame_bytes));
    if (header.payload_bytes > answers->count - done - WIRE_BYTES_header) {
      break;
    }
    done += WIRE_BYTES_header;
    uint8_t *payload = exact_copy(answers->bytes + done, header.payload_bytes);
    last += check_answer(&header, payload, header.payload_bytes, &next_part);
    free(payload);
    done += header.payload_bytes;
  }
  CHECK(may_be_cut || done == answers->count);
  return last;
}

/* Returns true if the request is slow and the time for slow requests is used up. */
static bool skip_slow(bool slow) {
  static uint64_t began_ns;
  began_ns = began_ns == 0 ? uv_hrtime() : began_ns;
  return slow && slow_ns > (uv_hrtime() - began_ns) / 10;
}

static void read_answers(int fd, struct gathered *answers, bool *end) {
  ssize_t got;
  while ((got = read(fd, gather_room(answers, 65536), 65536)) > 0) {
    answers->count += (size_t)got;
  }
  *end = got == 0 || errno != EAGAIN;
}

static void run_worker(uv_run_mode mode) {
  uv_run(&worker.loop, mode);
}

static bool send_pieces(int fd, struct delivery *delivery, struct gathered *answers, bool reads) {
  const uint8_t *piece;
  size_t bytes;
  bool end = false;
  while ((bytes = next_piece(delivery, &piece)) > 0) {
    while (bytes > 0 && !end) {
      const ssize_t sent = send(fd, piece, bytes, MSG_NOSIGNAL);
      if (sent > 0) {
        piece += sent;
        bytes -= (size_t)sent;
      } else if (errno != EAGAIN) {
        return true;
      }
      run_worker(UV_RUN_NOWAIT);
      if (reads || sent <= 0) {
        read_answers(fd, answers, &end);
      }
    }
  }
  return end;
}

/* Checks that all memory has been returned. A Monte Carlo job that was dropped returns its own a
 * little later, when its thread has finished with it. */
static void check_nothing_held(void) {
  for (int ms = 0; ms < 10000 && atomic_load(&server.buffer_bytes) > 0; ms++) {
    usleep(1000);
  }
  CHECK(atomic_load(&server.buffer_bytes) == 0 && worker.context.owed_radii == 0);
}

/* Plays the peer of a client: sends all bytes, shuts down its side, and reads to the end. If
 * `rude`, closes after the last byte. Frees the client. */
static void talk(int fd, struct delivery *delivery, unsigned manners, struct gathered *answers) {
  const bool rude = manners & 1, reads = !(manners & 2);
  bool end = send_pieces(fd, delivery, answers, reads);
  if (!rude) {
    shutdown(fd, SHUT_WR);
    while (!end) {
      run_worker(UV_RUN_ONCE);
      read_answers(fd, answers, &end);
    }
  }
  close(fd);
}

/* The target for a connection with its socket. The first byte of an input says in which pieces the
 * stream arrives, and the second how the peer behaves. */
static void connection(const uint8_t *data, size_t size) {
  int fds[2];
  struct gathered answers = {0};
  if (size < 3) {
    return;
  }
  const unsigned manners = data[1];
  const struct expected expected = expect_answers(data + 2, size - 2);
  if (skip_slow(expected.slow)) {
    return;
  }
  const uint64_t began_ns = uv_hrtime();
  CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, fds) == 0);
  struct client *client = connection_new(&server, fds[0], CONNECTION_SERVE);
  stats_add(&server.stats, STATS_CONNECTIONS_OPEN, 1);
  worker_give(&worker, client);
  struct delivery delivery = begin_delivery(data, 1);
  delivery.at = data + 2;
  delivery.left = size - 2;
  talk(fds[1], &delivery, manners, &answers);
  const size_t answered = check_answers(&answers, manners & 1);
  CHECK(manners & 1 || (answered >= expected.least && answered <= expected.most));
  while (atomic_load(&worker.client_count) > 0) {
    run_worker(UV_RUN_ONCE);
  }
  check_nothing_held();
  free(answers.bytes);
  slow_ns += expected.slow ? uv_hrtime() - began_ns : 0;
}

/* Requests without a socket and a connection: bytes go into an input, and come out of an output. */
struct pipe {
  struct input input;
  struct output output;
  struct requests requests;
  struct cache_owner owner;
  struct gathered answers;
};

static void drain(struct pipe *pipe) {
  while (pipe->output.ready_bytes > 0) {
    uv_buf_t buffer;
    CHECK(output_buffers(&pipe->output, &buffer, 1) == 1);
    memcpy(gather_room(&pipe->answers, buffer.len), buffer.base, buffer.len);
    pipe->answers.count += buffer.len;
    output_consume(&pipe->output, buffer.len);
  }
}

static void answer_all(struct pipe *pipe, bool to_the_end) {
  struct requests *requests = &pipe->requests;
  for (;;) {
    uint64_t budget = JOB_SLICE_RADII;
    while (requests_step(requests, &budget)) {
      budget = JOB_SLICE_RADII;
      if (output_is_full(&pipe->output)) {
        batch_finish(&worker.context.batch, &server.stats);
        drain(pipe);
      }
    }
    CHECK(!requests->no_room);
    batch_finish(&worker.context.batch, &server.stats);
    requests_step_detached(requests);
    drain(pipe);
    if (requests->job == NULL && (requests->detached == NULL || !to_the_end)) {
      return;
    }
    if (requests->waiting || requests->job == NULL) {
      run_worker(UV_RUN_ONCE); /* runs until a profile or a Monte Carlo job is ready */
    }
  }
}

static void on_pipe_wake(void *owner) {
  (void)owner;
}

static void arrive(struct pipe *pipe, const uint8_t *bytes, size_t count) {
  while (count > 0) {
    uint8_t *room;
    const size_t most = input_room(&pipe->input, &room);
    const size_t now = count < most ? count : most;
    CHECK(most > 0);
    memcpy(room, bytes, now);
    input_arrived(&pipe->input, now, uv_hrtime());
    bytes += now;
    count -= now;
    answer_all(pipe, false);
  }
}

static void requests(const uint8_t *data, size_t size) {
  struct pipe pipe = {0};
  const uint8_t *piece;
  size_t bytes;
  if (size < 1) {
    return;
  }
  const struct expected expected = expect_answers(data + 1, size - 1);
  if (skip_slow(expected.slow)) {
    return;
  }
  const uint64_t began_ns = uv_hrtime();
  uv_update_time(&worker.loop);
  input_init(&pipe.input, &server);
  output_init(&pipe.output, &server);
  requests_init(&pipe.requests, &pipe.input, &pipe.output, on_pipe_wake, &pipe);
  pipe.requests.context = &worker.context;
  pipe.requests.profiles = &pipe.owner;
  struct delivery delivery = begin_delivery(data, size);
  while ((bytes = next_piece(&delivery, &piece)) > 0) {
    arrive(&pipe, piece, bytes);
  }
  answer_all(&pipe, true);
  const bool broken_off = !pipe.requests.ended && input_partial(&pipe.input);
  const size_t answered = check_answers(&pipe.answers, false) + broken_off;
  CHECK(answered >= expected.least && answered <= expected.most);
  requests_drop(&pipe.requests);
  input_free(&pipe.input);
  output_free(&pipe.output);
  run_worker(UV_RUN_NOWAIT); /* so that the handles of jobs are freed */
  check_nothing_held();
  free(pipe.answers.bytes);
  slow_ns += expected.slow ? uv_hrtime() - began_ns : 0;
}

/* ---- frames: the connection's input -----------------------------------------------------------
 */

/* Cuts a stream into frames, and gathers the results of input_frame() for all of them. */
static void cut_frames(struct delivery delivery, struct gathered *seen) {
  struct input input;
  const uint8_t *piece;
  size_t bytes;
  uint64_t now_ns = 1;
  bool lost = false;
  input_init(&input, &server);
  while (!lost && (bytes = next_piece(&delivery, &piece)) > 0) {
    while (bytes > 0 && !lost) {
      uint8_t *room;
      const size_t most = input_room(&input, &room);
      const size_t count = bytes < most ? bytes : most;
      CHECK(most > 0 && (uintptr_t)input.bytes % 8 == 0);
      memcpy(room, piece, count);
      input_arrived(&input, count, now_ns++);
      piece += count;
      bytes -= count;
      wire_header header;
      const uint8_t *payload = NULL;
      wire_error error = {0};
      enum input_outcome outcome;
      while ((outcome = input_frame(&input, &header, &payload, &error)) != INPUT_INCOMPLETE) {
        const uint8_t kind = (uint8_t)outcome;
        CHECK(input_arrival_ns(&input, &header) < now_ns);
        memcpy(gather_room(seen, 1), &kind, 1);
        seen->count++;
        wire_put_header(gather_room(seen, WIRE_BYTES_header), &header);
        seen->count += WIRE_BYTES_header;
        if (outcome == INPUT_FRAME) {
          CHECK((uintptr_t)payload % 8 == 0);
          memcpy(gather_room(seen, header.payload_bytes), payload, header.payload_bytes);
          seen->count += header.payload_bytes;
        } else {
          wire_put_error(gather_room(seen, WIRE_BYTES_error), &error);
          seen->count += WIRE_BYTES_error;
        }
        lost = outcome == INPUT_LOST;
        if (lost) {
          break;
        }
        input_next(&input, &header);
      }
    }
  }
  input_free(&input);
}

/* The target for the input of connections: a stream gives the same frames, in whatever pieces it
 * arrives. */
static void frames(const uint8_t *data, size_t size) {
  struct gathered whole = {0}, pieces = {0};
  if (size < 1) {
    return;
  }
  struct delivery delivery = begin_delivery(data, size);
  cut_frames(delivery, &pieces);
  delivery.piece = 0;
  cut_frames(delivery, &whole);
  CHECK(whole.count == pieces.count &&
        (whole.count == 0 || memcmp(whole.bytes, pieces.bytes, whole.count) == 0));
  free(whole.bytes);
  free(pieces.bytes);
}

/* ---- Modbus ------------------------------------------------------------------------------------
 */

/* Resets all registers, so that each input finds them as after a start. */
static void reset_units(void) {
  modbus_queue_end(&units->queue);
  for (unsigned number = 1; number <= MODBUS_UNITS; number++) {
    struct modbus_unit *unit = &units->units[number];
    if (unit->units != NULL) {
      CHECK(!unit->evaluating);
      memset(unit, 0, sizeof *unit);
    }
  }
}

static void check_pdu(const uint8_t *request, size_t request_bytes, const uint8_t *answer,
                      size_t bytes) {
  static const uint8_t exact_bytes[] = {[1] = 5, 5, 5, 5, 5, 5, [17] = 1, [22] = 7};
  CHECK(bytes >= 2 && bytes <= MODBUS_PDU_MAX);
  CHECK(answer[0] == request[0] || (answer[0] == (request[0] | 0x80) && bytes == 2));
  CHECK(answer[0] >= sizeof exact_bytes || exact_bytes[answer[0]] == 0 ||
        exact_bytes[answer[0]] == request_bytes);
}

/* Checks the answers to a stream, which come in its order. The daemon closes the connection after
 * bytes that are no frame. */
static void check_modbus(const uint8_t *at, size_t left, const struct gathered *answers) {
  const uint8_t *answer = answers->bytes;
  size_t rest = answers->count;
  while (left >= 8 && at[2] == 0 && at[3] == 0 && at[4] == 0 && at[5] >= 2 && at[5] <= 254 &&
         at[7] < 0x80 && left >= 6u + at[5]) {
    CHECK(rest >= 8 && memcmp(answer, at, 2) == 0 && answer[6] == at[6] && answer[4] == 0);
    const size_t bytes = 6 + (size_t)answer[5];
    CHECK(rest >= bytes);
    check_pdu(at + 7, at[5] - 1u, answer + 7, bytes - 7);
    answer += bytes;
    rest -= bytes;
    left -= 6u + at[5];
    at += 6 + at[5];
  }
  CHECK(rest == 0);
}

/* The target for Modbus TCP with its socket. The first two bytes of an input have the meaning that
 * they have for connection(). */
static void modbus(const uint8_t *data, size_t size) {
  int fds[2];
  struct gathered answers = {0};
  if (size < 3) {
    return;
  }
  CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, fds) == 0);
  struct modbus_connection *client = modbus_connection_new(units, fds[0]);
  stats_add(&server.stats, STATS_MODBUS_CONNECTIONS_OPEN, 1);
  worker_give(&worker, &client->client);
  struct delivery delivery = begin_delivery(data, 1);
  delivery.at = data + 2;
  delivery.left = size - 2;
  talk(fds[1], &delivery, data[1], &answers);
  if (!(data[1] & 1)) {
    check_modbus(data + 2, size - 2, &answers);
  }
  while (units->users > 0) {
    run_worker(UV_RUN_ONCE);
  }
  reset_units();
  free(answers.bytes);
}

/* A serial line without a terminal (server/modbus/line.c). */
struct serial {
  struct client client;
  struct modbus_receiver receiver;
  struct modbus_diagnostics diagnostics;
  bool echoes; /* whether the adapter returns the bytes that are written to it */
  uint64_t now_ns;
};

static void arrive_serial(struct serial *line, const uint8_t *bytes, size_t count) {
  while (count > 0) {
    size_t room;
    uint8_t *at = modbus_receiver_room(&line->receiver, &room);
    CHECK(room > 0);
    room = count < room ? count : room;
    memcpy(at, bytes, room);
    modbus_receiver_arrived(&line->receiver, room, line->now_ns);
    bytes += room;
    count -= room;
  }
}

static void send_serial(struct serial *line, uint8_t *frame, size_t pdu_bytes) {
  const size_t bytes = 3 + pdu_bytes;
  frame[0] = 1;
  const uint16_t sum = modbus_rtu_checksum(frame, 1 + pdu_bytes);
  frame[1 + pdu_bytes] = (uint8_t)sum;
  frame[2 + pdu_bytes] = (uint8_t)(sum >> 8);
  const bool probing = modbus_receiver_sent(&line->receiver, frame, bytes);
  arrive_serial(line, frame, line->echoes && probing ? 1 : 0);
  if (probing) {
    modbus_receiver_probed(&line->receiver);
  }
  arrive_serial(line, frame + probing, line->echoes ? bytes - probing : 0);
}

static void answer_serial(struct serial *line, const struct modbus_burst *burst) {
  uint8_t frame[MODBUS_RTU_MAX];
  const size_t bytes = burst->bytes - 3;
  struct modbus_unit *unit = NULL;
  size_t answered;
  CHECK(modbus_rtu_is_frame(burst->request, burst->bytes) && burst->request[0] <= 1);
  uint8_t *pdu = exact_copy(burst->request + 1, bytes);
  if ((burst->request[0] == 0 && !modbus_pdu_writes(pdu[0])) ||
      !modbus_diagnostics_allows(&line->diagnostics, pdu, bytes)) {
    free(pdu);
    return;
  }
  if (pdu[0] == MODBUS_FC_DIAGNOSTICS) {
    answered = modbus_diagnostics_answer(&line->diagnostics, pdu, bytes, frame + 1);
  } else {
    answered = modbus_answer(units, &line->client, 1, pdu, bytes, frame + 1, &unit);
  }
  if (unit != NULL && answered == 0) {
    batch_finish(&worker.context.batch, &server.stats);
    units->client.kind->finish(&units->client);
    CHECK(!unit->evaluating);
    answered = modbus_answer_late(unit, pdu, bytes, frame + 1);
  }
  CHECK(answered > 0 || pdu[0] == MODBUS_FC_DIAGNOSTICS);
  if (answered > 0 && burst->request[0] == 1) {
    check_pdu(pdu, bytes, frame + 1, answered);
    modbus_diagnostics_count(&line->diagnostics, frame + 1);
    send_serial(line, frame, answered);
  }
  free(pdu);
}

static void on_serial_finish(struct client *client) {
  (void)client;
}

/* The bits of a byte that say how a piece arrives. */
enum { WITH_CHECKSUM = 1, AFTER_A_PAUSE = 2, BEFORE_A_SILENCE = 4, WITH_ECHO = 8 };

/* The target for Modbus RTU. An input is a row of pieces: how a piece arrives, its length, its
 * bytes. */
static void rtu(const uint8_t *data, size_t size) {
  static const struct client_kind kind = {.finish = on_serial_finish};
  struct serial line = {.client = {.kind = &kind, .worker = &worker},
                        .receiver = {.number = 1, .silence_ns = 1000}};
  while (size >= 2) {
    const unsigned how = data[0];
    const size_t length = data[1] < size - 2 ? data[1] : size - 2;
    const uint16_t sum = modbus_rtu_checksum(data + 2, length);
    const uint8_t checksum[] = {(uint8_t)sum, (uint8_t)(sum >> 8)};
    line.now_ns += how & AFTER_A_PAUSE ? line.receiver.silence_ns : 1;
    line.echoes = how & WITH_ECHO;
    arrive_serial(&line, data + 2, length);
    arrive_serial(&line, checksum, how & WITH_CHECKSUM ? sizeof checksum : 0);
    modbus_receiver_is_whole(&line.receiver);
    if (how & BEFORE_A_SILENCE) {
      struct modbus_burst burst;
      modbus_receiver_end(&line.receiver, &burst);
      if (burst.bytes > 0) {
        answer_serial(&line, &burst);
      }
    }
    data += 2 + length;
    size -= 2 + length;
  }
  reset_units();
}

/* ---- tables from elsewhere ---------------------------------------------------------------------
 */

static uint8_t *whole_table; /* a valid table: the frame of a table reply */
static size_t whole_table_bytes;

static void make_table(void) {
  const core_medium medium = {0.032, 0.74, 0, 1.3};
  core_parameters parameters;
  core_profile profile;
  for (int i = 0; i < CORE_PARAMETERS_END; i++) {
    parameters.value[i] = (double)NAN;
  }
  parameters.value[CORE_PARAMETER_TOLERANCE] = CORE_LUT_TOLERANCE_MAX;
  CHECK(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BETTER, CORE_MOMENTS_EXACT,
                             CORE_EVALUATOR_LUT, &medium, &parameters)
            .field == NULL);
  const size_t payload_bytes = table_reply_bytes(1, profile.lut_count);
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_TABLE | WIRE_REPLY,
                              .payload_bytes = (uint32_t)payload_bytes};
  whole_table_bytes = WIRE_BYTES_header + payload_bytes;
  whole_table = malloc(whole_table_bytes);
  wire_put_header(whole_table, &header);
  table_reply_put(whole_table + WIRE_BYTES_header, &profile, &parameters);
  core_profile_free(&profile);
}

/* The octaves of positive floats, from OCTAVE_FIRST to OCTAVE_END - 1. The radii are the first and
 * the last float of each octave, and then 0 and infinity. */
enum { OCTAVE_FIRST = -149, OCTAVE_END = 128, RADII = 2 * (OCTAVE_END - OCTAVE_FIRST) + 2 };

static void check_same(const float *a, const float *b) {
  for (int i = 0; i < RADII; i++) {
    CHECK(a[i] == b[i] || (a[i] != a[i] && b[i] != b[i]));
  }
}

/* Evaluates the table at all radii, by the best instruction set and by the portable one, of which
 * the sanitizer sees every read. */
static void check_table(const dipole_table *table, const uint8_t *payload, size_t payload_bytes) {
  float r[RADII], u[RADII], best[RADII], portable[RADII];
  wire_table_reply fixed;
  core_parameters parameters;
  const float *words;
  for (int octave = OCTAVE_FIRST, i = 0; octave < OCTAVE_END; octave++, i += 2) {
    r[i] = ldexpf(1, octave);
    r[i + 1] = nextafterf(2 * r[i], 0);
    u[i] = octave < 0 ? r[i] : 1 - ldexpf(1, -octave);
    u[i + 1] = octave < 0 ? r[i + 1] : nextafterf(u[i], 0);
  }
  r[RADII - 2] = u[RADII - 2] = 0;
  r[RADII - 1] = (float)INFINITY;
  u[RADII - 1] = 1;
  CHECK(table_reply_parse(payload, payload_bytes, &fixed, &parameters, &words));
  core_profile profile = {.medium = {fixed.sigma_a, fixed.sigma_s, fixed.g, fixed.eta},
                          .model = (enum core_model)fixed.model,
                          .albedo = fixed.albedo,
                          .radii = {fixed.radius_least, fixed.radius_most}};
  CHECK(core_profile_from_table(&profile, core_isa_select("portable"), words, fixed.word_count)
            .field == NULL);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if (dipole_table_values(table, (enum dipole_quantity)quantity->id, RADII, r, best) &&
        quantity->id != CORE_QUANTITY_S) { /* S depends on the angles. */
      core_eval_f32(&profile, (enum core_quantity)quantity->id, RADII, r, portable);
      check_same(best, portable);
    }
  }
  dipole_errors errors;
  if (dipole_table_errors(table, DIPOLE_R, RADII, r, &errors)) {
    double least = fixed.numerical_error;
    for (size_t i = 0; i < CORE_MODEL_ERROR_BANDS; i++) {
      least = fixed.numerical_errors[i] < least ? fixed.numerical_errors[i] : least;
    }
    CHECK(!(errors.numerical_error < least));
  }
  CHECK(dipole_table_radii(table, RADII, u, best));
  core_sample_f32(&profile, RADII, u, portable);
  check_same(best, portable);
  core_profile_free(&profile);
}

/* The target for tables. An input is a row of changes to a valid table: the number of a word, two
 * bytes, and its new value, four bytes. A number beyond the words cuts the table short. Afterwards
 * the checksum, and fields that repeat words, are corrected, unless the last byte is odd. */
static void table(const uint8_t *data, size_t size) {
  size_t bytes = whole_table_bytes;
  uint8_t *frame = exact_copy(whole_table, bytes);
  const bool put_right = size % 6 == 0 || !(data[size - 1] & 1);
  for (; size >= 6; size -= 6, data += 6) {
    const size_t at = 4 * (data[0] | (size_t)data[1] << 8);
    if (at + 4 <= bytes) {
      memcpy(frame + at, data + 2, 4);
    } else if (data[2] * (size_t)16 < bytes) {
      bytes -= data[2] * (size_t)16;
    }
  }
  if (put_right && bytes >= WIRE_BYTES_header + table_reply_bytes(1, CORE_LUT_PIECES)) {
    wire_table_reply fixed;
    float first, last;
    uint8_t *payload = frame + WIRE_BYTES_header;
    wire_get_table_reply(payload, &fixed);
    const size_t words_at = table_reply_bytes(1, 0);
    const uint32_t payload_bytes = (uint32_t)(bytes - WIRE_BYTES_header);
    memcpy(frame + 16, &payload_bytes, sizeof payload_bytes);
    fixed.parameter_count = 1;
    fixed.word_count = (uint32_t)((payload_bytes - words_at) / sizeof(float));
    fixed.checksum = table_checksum(payload + words_at, fixed.word_count * sizeof(float));
    memcpy(&first, payload + words_at + CORE_LUT_FIRST_MM * sizeof first, sizeof first);
    memcpy(&last, payload + words_at + CORE_LUT_LAST_MM * sizeof last, sizeof last);
    fixed.pieces_from = (double)first;
    fixed.pieces_to = (double)last;
    wire_put_table_reply(payload, &fixed);
  }
  dipole_table *loaded;
  dipole_error error;
  uint8_t *exact = exact_copy(frame, bytes);
  if (dipole_table_load(exact, bytes, &loaded, &error)) {
    const uint8_t *kept = dipole_table_bytes(loaded, &bytes);
    check_table(loaded, kept + WIRE_BYTES_header, bytes - WIRE_BYTES_header);
    dipole_table_free(loaded);
  } else {
    CHECK(error.kind == DIPOLE_ERROR_TABLE && error.text[0] != '\0');
  }
  free(exact);
  free(frame);
}

/* ---- answers to a client ------------------------------------------------------------------------
 */

static bool take_part(void *context, const dipole_result *part, uint64_t radius_first) {
  const uint64_t *limit = context;
  return part->radius_count + radius_first < *limit;
}

static bool see_progress(void *context, const dipole_mc_progress *now) {
  const uint64_t *limit = context;
  return now->photons < *limit;
}

/* Makes the call whose answer has this type. */
static bool ask(dipole_client *client, unsigned type, unsigned how, dipole_error *error) {
  static const dipole_medium media[] = {{0.032, 0.74, 0, 1.3}, {0.17, 0.88, 0, 1.3}};
  static const double radii[] = {0.5, 1}, albedos[] = {0.5, 0.3, 1};
  double values[16], into_radii[2];
  const bool into = how & 1;
  dipole_query query = {.model = CORE_MODEL_BETTER,
                        .evaluator = DIPOLE_F64,
                        .moments = DIPOLE_EXACT,
                        .wanted = how >> 4 ? how >> 4 : 7,
                        .media = media,
                        .medium_count = 1 + (how >> 1 & 1),
                        .spacing = DIPOLE_LIST,
                        .radii = radii,
                        .radius_count = 2,
                        .into_values = into ? values : NULL,
                        .into_radii = into ? into_radii : NULL};
  uint64_t limit = 2;
  bool good;
  switch (type) {
  case WIRE_TYPE_EVAL: {
    dipole_result *result;
    if (how & 4) {
      return dipole_eval_parts(client, &query, take_part, &limit, error);
    }
    if ((good = dipole_eval(client, &query, &result, error))) {
      dipole_result_free(result);
    }
    return good;
  }
  case WIRE_TYPE_SAMPLE: {
    dipole_result *result;
    const dipole_sample_query sample = {.model = CORE_MODEL_BETTER,
                                        .evaluator = DIPOLE_F64,
                                        .moments = DIPOLE_EXACT,
                                        .wanted = query.wanted,
                                        .media = media,
                                        .medium_count = query.medium_count,
                                        .draw = DIPOLE_DRAW_REGULAR,
                                        .sample_count = 4};
    if ((good = dipole_sample(client, &sample, &result, error))) {
      dipole_result_free(result);
    }
    return good;
  }
  case WIRE_TYPE_INVERT: {
    dipole_inversion *inversion;
    const dipole_invert_query invert = {.model = CORE_MODEL_BETTER,
                                        .moments = DIPOLE_EXACT,
                                        .given = DIPOLE_MEAN_FREE_PATH,
                                        .eta = 1.3,
                                        .albedos = albedos,
                                        .lengths_mm = radii,
                                        .medium_count = query.medium_count};
    if ((good = dipole_invert(client, &invert, &inversion, error))) {
      dipole_inversion_free(inversion);
    }
    return good;
  }
  case WIRE_TYPE_MC: {
    dipole_mc_result *result;
    const dipole_mc_query mc = {.medium = media[0],
                                .albedos = albedos,
                                .albedo_count = how >> 1 & 3,
                                .thickness_mm = how & 8 ? 1 : (double)INFINITY,
                                .spacing = DIPOLE_LINEAR,
                                .ring_count = 2 + (how >> 4),
                                .radius_stop_mm = 1,
                                .photons = 8};
    if ((good = dipole_mc(client, &mc, into ? see_progress : NULL, &limit, &result, error))) {
      dipole_mc_result_free(result);
    }
    return good;
  }
  case WIRE_TYPE_TABLE: {
    dipole_table *fetched;
    const dipole_table_query asked = {
        .model = CORE_MODEL_BETTER, .moments = DIPOLE_EXACT, .medium = media[0]};
    if ((good = dipole_table_fetch(client, &asked, &fetched, error))) {
      dipole_table_free(fetched);
    }
    return good;
  }
  case WIRE_TYPE_OFFERS: {
    dipole_offer *offers;
    size_t count, taken;
    query.model = DIPOLE_ANY_MODEL;
    if ((good = dipole_offers(client, &query, &offers, &count, &taken, error))) {
      free(offers);
    }
    return good;
  }
  case WIRE_TYPE_MEDIA: {
    dipole_measured_medium *measured;
    size_t count;
    if ((good = dipole_media(client, &measured, &count, error))) {
      free(measured);
    }
    return good;
  }
  case WIRE_TYPE_STATS: {
    dipole_value *statistics;
    size_t count;
    if ((good = dipole_statistics(client, &statistics, &count, error))) {
      free(statistics);
    }
    return good;
  }
  case WIRE_TYPE_PING:
    return dipole_ping(client, error);
  default:
    free(client->info);
    client->info = NULL;
    return libdipole_hello(client, "fuzz", error);
  }
}

/* The target for a client. The first byte of an input says which call the client makes, and the
 * second how. The other bytes are the daemon's answer. */
static void replies(const uint8_t *data, size_t size) {
  int fds[2];
  if (size < 2 + WIRE_BYTES_header || size > 65536) {
    return;
  }
  wire_header header;
  wire_get_header(data + 2, &header);
  dipole_client *client = calloc(1, sizeof *client);
  dipole_error error = {0};
  CHECK(client != NULL && dipole_local_info(&client->info, &error));
  CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, fds) == 0);
  CHECK(send(fds[1], data + 2, size - 2, MSG_NOSIGNAL) == (ssize_t)(size - 2));
  shutdown(fds[1], SHUT_WR);
  libdipole_stream_init(&client->stream, fds[0]);
  client->last_id = header.request_id - 1 < UINT64_MAX - 2 ? header.request_id - 1 : 0;
  client->in_flight_max = 16;
  for (int call = 0; call < 2; call++) {
    error = (dipole_error){0};
    const bool good = ask(client, data[0], data[1], &error);
    CHECK(good == (error.kind == DIPOLE_ERROR_NONE));
  }
  close(fds[1]);
  dipole_close(client);
}

/* ---- the command line
 * ---------------------------------------------------------------------------- */

static FILE *nowhere;
static int file;

/* Discards what the command line writes to standard error. */
static void start_command_line(void) {
  nowhere = fopen("/dev/null", "w");
  file = memfd_create("fuzz", MFD_CLOEXEC);
  CHECK(nowhere != NULL && file >= 0);
  stderr = nowhere;
}

/* The target for files of `dipole points`. The bytes that are read are all bytes of the file, in
 * their order. */
static void csv(const uint8_t *data, size_t size) {
  static cli_csv_reader reader;
  cli_csv_record record = {0};
  CHECK(ftruncate(file, 0) == 0 && pwrite(file, data, size, 0) == (ssize_t)size &&
        lseek(file, 0, SEEK_SET) == 0);
  reader = (cli_csv_reader){.fd = file};
  size_t done = 0;
  enum cli_csv_kind kind;
  while ((kind = cli_csv_read(&reader, &record)) == CLI_CSV_RECORD || kind == CLI_CSV_COMMENT) {
    CHECK(record.length > 0 && record.length <= size - done);
    CHECK(memcmp(record.bytes, data + done, record.length) == 0);
    done += record.length;
    for (size_t i = 0; kind == CLI_CSV_RECORD && i < record.cell_count; i++) {
      size_t length;
      double value;
      CHECK(record.cells[i].begin <= record.cells[i].end && record.cells[i].end <= record.length);
      char *text = cli_csv_cell_text(&record, i, &length);
      CHECK(text[length] == '\0');
      cli_number_parse(text, &value);
      cli_csv_copy_cell(&record, i, nowhere);
      cli_csv_write_cell(text, nowhere);
      free(text);
    }
    cli_csv_record_trim(&record);
  }
  CHECK(kind != CLI_CSV_END || done == size);
  cli_csv_record_free(&record);
}

/* The target for options of the daemon, one behind each zero byte. Each is also read as an address,
 * a network and a number. */
static void texts(const uint8_t *data, size_t size) {
  enum { WORDS = 40 };
  char *words[WORDS + 2] = {"dipoled"};
  int count = 1;
  char *copy = malloc(size + 1);
  memcpy(copy, data, size);
  copy[size] = '\0';
  for (size_t at = 0; at < size && count <= WORDS; at += strlen(copy + at) + 1) {
    char *word = words[count++] = copy + at;
    libdipole_addresses addresses;
    libdipole_address address;
    dipole_error error = {0};
    if (libdipole_addresses_parse(word, &addresses, &error)) {
      CHECK(addresses.count > 0 && addresses.count <= DIPOLE_ADDRESSES_MAX);
      for (size_t i = 0; i < addresses.count; i++) {
        libdipole_address_parse(addresses.texts[i], &address, &error);
      }
    } else {
      CHECK(error.text[0] != '\0');
    }
    libdipole_addresses_free(&addresses);
    const struct options_list list = {.items = {word}, .count = 1};
    struct modbus_access access;
    const char *wrong;
    if (modbus_access_read(&list, &access, &wrong)) {
      CHECK(access.count == 1 && access.networks[0].bits <= 128);
    }
    double value, again;
    uint64_t number;
    char text[CLI_NUMBER_BYTES];
    if (cli_number_parse(word, &value)) {
      CHECK(cli_number_parse(cli_number_format(value, text), &again));
      CHECK(again == value || value != value);
    }
    cli_count_parse(word, &number);
  }
  struct options options;
  optind = 0; /* so that getopt_long() starts anew */
  options_read(count, words, &options);
  options_free(&options);
  free(copy);
}

static void start_texts(void) {
  start_command_line();
  stdout = nowhere;
}

/* ---- the list
 * ------------------------------------------------------------------------------------ */

static const struct fuzz_target {
  const char *name;
  void (*start)(void); /* called once before the first input; NULL: there is nothing to do */
  void (*run)(const uint8_t *data, size_t size);
} fuzz_targets[] = {
    {"frames", start_daemon, frames},     {"messages", NULL, messages},
    {"requests", start_daemon, requests}, {"connection", start_daemon, connection},
    {"modbus", start_modbus, modbus},     {"rtu", start_modbus, rtu},
    {"table", make_table, table},         {"replies", NULL, replies},
    {"csv", start_command_line, csv},     {"texts", start_texts, texts},
};

static const struct fuzz_target *target;

int LLVMFuzzerInitialize(int *argc, char ***argv) {
  (void)argc;
  (void)argv;
  const char *name = getenv("FUZZ_TARGET");
  for (size_t i = 0; name != NULL && i < sizeof fuzz_targets / sizeof *fuzz_targets; i++) {
    target = strcmp(fuzz_targets[i].name, name) == 0 ? &fuzz_targets[i] : target;
  }
  if (target == NULL) {
    for (size_t i = 0; i < sizeof fuzz_targets / sizeof *fuzz_targets; i++) {
      puts(fuzz_targets[i].name);
    }
    exit(2);
  }
  if (target->start != NULL) {
    target->start();
  }
  return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  target->run(data, size);
  return 0;
}
