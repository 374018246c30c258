/* The targets for a daemon of the binary protocol: `frames`, `requests` and `connection`. */
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

#include "proto/eval.h"
#include "proto/fit.h"
#include "proto/gather.h"
#include "proto/mc.h"
#include "proto/varying.h"
#include "server/jobs/requests.h"
#include "server/net/connection.h"
#include "tests/fuzz/daemon.h"

/* ---- what is expected ---------------------------------------------------------------------------- */

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
  } else if (type == WIRE_TYPE_VARYING && size >= WIRE_BYTES_varying_request) {
    wire_varying_request varying;
    wire_get_varying_request(payload, &varying);
    eval.fixed.model = varying.model;
  } else if (type == WIRE_TYPE_GATHER && size >= WIRE_BYTES_gather_request) {
    wire_gather_request gather;
    wire_get_gather_request(payload, &gather);
    eval.fixed.model = gather.model;
    eval.fixed.evaluator = gather.evaluator;
  }
  return type == WIRE_TYPE_TABLE || type == WIRE_TYPE_FIT || eval.fixed.model == EVAL_ANY_MODEL ||
         core_prepares_slowly(eval.fixed.model, eval.fixed.evaluator, NULL, NULL);
}

/* Returns whether the message's fields and lengths allow a fit of layers to begin. */
static bool may_fit_layers(const uint8_t *payload, size_t size) {
  schema_layout layout;
  uint8_t *copy = fuzz_copy(payload, size);
  const wire_error error = schema_check(&schema_fit_layers_request, copy, size, &layout);
  free(copy);
  return error.status == WIRE_STATUS_OK;
}

/* The number of answers to a stream: one for each whole frame, each refused header, and an
 * incomplete frame at the end. After a wrong magic number, detached requests may end without an
 * answer. */
struct expected {
  size_t least;
  size_t most;
  bool slow;        /* whether a request may take long */
  bool fits_layers; /* whether one may take minutes under the sanitizers: the input is skipped */
};

static struct expected expect_answers(const uint8_t *at, size_t left) {
  size_t count = 0, jobs = 0;
  bool slow = false, fits_layers = false;
  while (left >= WIRE_BYTES_header) {
    wire_header header;
    wire_get_header(at, &header);
    if (header.magic != WIRE_MAGIC) {
      return (struct expected){count + 1 - jobs, count + 1, slow, fits_layers};
    }
    const bool good = wire_header_is_good(&header, fuzz_server.options.max_frame_bytes);
    left -= WIRE_BYTES_header;
    at += WIRE_BYTES_header;
    count += !good;
    if (header.payload_bytes > left) {
      return (struct expected){count + 1, count + 1, slow, fits_layers};
    }
    count += good;
    jobs += good && (header.type == WIRE_TYPE_MC || header.type == WIRE_TYPE_GATHER);
    fits_layers |=
        good && header.type == WIRE_TYPE_FIT_LAYERS && may_fit_layers(at, header.payload_bytes);
    slow |= good && names_slow_profile(header.type, at, header.payload_bytes);
    at += header.payload_bytes;
    left -= header.payload_bytes;
  }
  count += left > 0;
  return (struct expected){count, count, slow, fits_layers};
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
  const bool refused = header->type == WIRE_TYPE_ERROR;
  const unsigned type = refused ? WIRE_TYPE_ERROR : header->type & ~(unsigned)WIRE_REPLY;
  wire_error error;
  wire_mc_reply walked;
  wire_part part;
  CHECK(refused ||
        (header->type & WIRE_REPLY && strcmp(wire_type_name(header->type), "unknown") != 0));
  switch (type) {
  case WIRE_TYPE_ERROR:
    CHECK(size == WIRE_BYTES_error);
    wire_get_error(payload, &error);
    CHECK(error.status != WIRE_STATUS_OK &&
          strcmp(wire_status_of(error.status)->name, "unknown") != 0);
    CHECK(error.allowed[0] != '\0');
    return true;
  case WIRE_TYPE_EVAL:
  case WIRE_TYPE_SAMPLE:
    fuzz_check_evaluated(payload, size, type == WIRE_TYPE_SAMPLE);
    break;
  case WIRE_TYPE_INVERT:
  case WIRE_TYPE_FIT:
  case WIRE_TYPE_VARYING:
  case WIRE_TYPE_GATHER:
    break;
  case WIRE_TYPE_POINTS:
    CHECK(fuzz_decode_reply(header->type, payload, size));
    return true;
  case WIRE_TYPE_MC:
    CHECK(fuzz_decode_reply(header->type, payload, size));
    wire_get_mc_reply(payload, &walked);
    return walked.state != MC_UNDER_WAY;
  default:
    return true;
  }
  CHECK(fuzz_decode_reply(header->type, payload, size));
  wire_get_part(payload, &part);
  /* Other answers may come between the parts of a sum of light. */
  return type == WIRE_TYPE_GATHER ? part.part + 1 == part.part_count
                                  : check_part(part.part, part.part_count, next_part);
}

/* Checks all answers to a stream. Returns how many requests they have answered completely. */
static size_t check_answers(const struct fuzz_bytes *answers, bool may_be_cut) {
  size_t done = 0, last = 0;
  uint32_t next_part = 0;
  while (answers->count - done >= WIRE_BYTES_header) {
    wire_header header;
    wire_get_header(answers->bytes + done, &header);
    CHECK(wire_header_is_good(&header, fuzz_server.options.max_frame_bytes));
    if (header.payload_bytes > answers->count - done - WIRE_BYTES_header) {
      break;
    }
    done += WIRE_BYTES_header;
    uint8_t *payload = fuzz_copy(answers->bytes + done, header.payload_bytes);
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

/* The target for a connection with its socket. The first byte of an input says in which pieces the
 * stream arrives, and the second how the peer behaves. */
void fuzz_connection(const uint8_t *data, size_t size) {
  int fds[2];
  struct fuzz_bytes answers = {0};
  if (size < 3) {
    return;
  }
  const unsigned manners = data[1];
  const struct expected expected = expect_answers(data + 2, size - 2);
  if (expected.fits_layers || skip_slow(expected.slow)) {
    return;
  }
  const uint64_t began_ns = uv_hrtime();
  CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, fds) == 0);
  struct client *client = connection_new(&fuzz_server, fds[0], NULL, CONNECTION_SERVE);
  stats_add(&fuzz_server.stats, STATS_CONNECTIONS_OPEN, 1);
  worker_give(&fuzz_worker, client);
  struct fuzz_delivery delivery = fuzz_delivery_begin(data, 1);
  delivery.at = data + 2;
  delivery.left = size - 2;
  fuzz_daemon_talk(fds[1], &delivery, manners, &answers);
  const size_t answered = check_answers(&answers, manners & 1);
  /* While a request is under way, the daemon sends a ping reply every 5 s (F3e). */
  const size_t pings = (uv_hrtime() - began_ns) / UINT64_C(5000000000);
  CHECK(manners & 1 || (answered >= expected.least && answered <= expected.most + pings));
  while (atomic_load(&fuzz_worker.client_count) > 0) {
    fuzz_daemon_run(UV_RUN_ONCE);
  }
  fuzz_daemon_check_freed();
  free(answers.bytes);
  slow_ns += expected.slow ? uv_hrtime() - began_ns : 0;
}

/* Requests without a socket and a connection: bytes go into an input, and come out of an output. */
struct pipe {
  struct input input;
  struct output output;
  struct requests requests;
  struct cache_owner owner;
  struct fuzz_bytes answers;
};

static void drain(struct pipe *pipe) {
  while (pipe->output.ready_bytes > 0) {
    uv_buf_t buffer;
    CHECK(output_buffers(&pipe->output, &buffer, 1) == 1);
    memcpy(fuzz_gather(&pipe->answers, buffer.len), buffer.base, buffer.len);
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
        batch_finish(&fuzz_worker.context.batch, &fuzz_server.stats);
        drain(pipe);
      }
    }
    CHECK(!requests->no_room);
    batch_finish(&fuzz_worker.context.batch, &fuzz_server.stats);
    budget = JOB_SLICE_RADII;
    const bool more = requests_step_detached(requests, &budget);
    drain(pipe);
    if (!requests_hold_input(requests) && (requests->detached_count == 0 || !to_the_end)) {
      return;
    }
    if (!more && (requests->run.state == RUN_WAITS || requests->run.state == RUN_IDLE)) {
      fuzz_daemon_run(UV_RUN_ONCE); /* runs until a profile or a Monte Carlo job is ready */
    }
  }
}

static void on_pipe_wake(void *owner) {
  (void)owner;
}

static void on_pipe_end(void *owner, const wire_error *error) {
  (void)owner, (void)error;
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

void fuzz_requests(const uint8_t *data, size_t size) {
  struct pipe pipe = {0};
  const uint8_t *piece;
  size_t bytes;
  if (size < 1) {
    return;
  }
  const struct expected expected = expect_answers(data + 1, size - 1);
  if (expected.fits_layers || skip_slow(expected.slow)) {
    return;
  }
  const uint64_t began_ns = uv_hrtime();
  uv_update_time(&fuzz_worker.loop);
  input_init(&pipe.input, &fuzz_server);
  output_init(&pipe.output, &fuzz_server);
  requests_init(&pipe.requests, &pipe.input, &pipe.output, on_pipe_wake, &pipe);
  pipe.requests.tell_end = on_pipe_end;
  pipe.requests.context = &fuzz_worker.context;
  pipe.requests.profiles = &pipe.owner;
  struct fuzz_delivery delivery = fuzz_delivery_begin(data, size);
  while ((bytes = fuzz_delivery_next(&delivery, &piece)) > 0) {
    arrive(&pipe, piece, bytes);
  }
  answer_all(&pipe, true);
  const bool broken_off = !pipe.requests.ended && input_partial(&pipe.input);
  const size_t answered = check_answers(&pipe.answers, false) + broken_off;
  CHECK(answered >= expected.least && answered <= expected.most);
  requests_drop(&pipe.requests);
  input_free(&pipe.input);
  output_free(&pipe.output);
  fuzz_daemon_run(UV_RUN_NOWAIT); /* so that the handles of jobs are freed */
  fuzz_daemon_check_freed();
  free(pipe.answers.bytes);
  slow_ns += expected.slow ? uv_hrtime() - began_ns : 0;
}

/* ---- frames: the input of connections ------------------------------------------------------------ */

/* Cuts a stream into frames, and gathers the results of input_frame() for all of them. */
static void cut_frames(struct fuzz_delivery delivery, struct fuzz_bytes *seen) {
  struct input input;
  const uint8_t *piece;
  size_t bytes;
  uint64_t now_ns = 1;
  bool lost = false;
  input_init(&input, &fuzz_server);
  while (!lost && (bytes = fuzz_delivery_next(&delivery, &piece)) > 0) {
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
        memcpy(fuzz_gather(seen, 1), &kind, 1);
        seen->count++;
        wire_put_header(fuzz_gather(seen, WIRE_BYTES_header), &header);
        seen->count += WIRE_BYTES_header;
        if (outcome == INPUT_FRAME) {
          CHECK((uintptr_t)payload % 8 == 0);
          memcpy(fuzz_gather(seen, header.payload_bytes), payload, header.payload_bytes);
          seen->count += header.payload_bytes;
        } else {
          wire_put_error(fuzz_gather(seen, WIRE_BYTES_error), &error);
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
void fuzz_frames(const uint8_t *data, size_t size) {
  struct fuzz_bytes whole = {0}, pieces = {0};
  if (size < 1) {
    return;
  }
  struct fuzz_delivery delivery = fuzz_delivery_begin(data, size);
  cut_frames(delivery, &pieces);
  delivery.piece = 0;
  cut_frames(delivery, &whole);
  CHECK(whole.count == pieces.count &&
        (whole.count == 0 || memcmp(whole.bytes, pieces.bytes, whole.count) == 0));
  free(whole.bytes);
  free(pieces.bytes);
}
