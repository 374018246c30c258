#include "tests/unit/scripted_peer.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "proto/eval.h"

static void *run(void *argument) {
  scripted_peer *peer = argument;
  bool more = true;
  for (size_t i = 0; more; i++) {
    void (*const script)(int, void *) = peer->scripts != NULL ? peer->scripts[i] : peer->script;
    const int fd = script != NULL ? accept4(peer->listener, NULL, NULL, SOCK_CLOEXEC) : -1;
    if (fd >= 0) {
      script(fd, peer->context);
      close(fd);
    }
    more = fd >= 0 && peer->scripts != NULL;
  }
  return NULL;
}

static void start(scripted_peer *peer) {
  struct sockaddr_un name = {.sun_family = AF_UNIX};
  snprintf(peer->folder, sizeof peer->folder, "/tmp/dipole-peer-XXXXXX");
  if (mkdtemp(peer->folder) == NULL) {
    abort();
  }
  snprintf(name.sun_path, sizeof name.sun_path, "%s/s", peer->folder);
  snprintf(peer->address, sizeof peer->address, "unix:%s/s", peer->folder);
  peer->listener = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (bind(peer->listener, (const struct sockaddr *)&name, sizeof name) != 0 ||
      listen(peer->listener, 4) != 0 || pthread_create(&peer->thread, NULL, run, peer) != 0) {
    abort();
  }
}

void peer_start(scripted_peer *peer, void (*script)(int fd, void *context), void *context) {
  *peer = (scripted_peer){.script = script, .context = context};
  start(peer);
}

void peer_start_scripts(scripted_peer *peer, void (*const *scripts)(int fd, void *context),
                        void *context) {
  *peer = (scripted_peer){.scripts = scripts, .context = context};
  start(peer);
}

void peer_end(scripted_peer *peer) {
  shutdown(peer->listener, SHUT_RDWR); /* This ends accept() if no client has connected. */
  pthread_join(peer->thread, NULL);
  close(peer->listener);
  unlink(peer->address + strlen("unix:"));
  rmdir(peer->folder);
}

static bool receive_bytes(int fd, void *bytes, size_t count) {
  return count == 0 || recv(fd, bytes, count, MSG_WAITALL) == (ssize_t)count;
}

bool peer_receive(int fd, peer_frame *frame) {
  uint8_t header[WIRE_BYTES_header];
  if (!receive_bytes(fd, header, sizeof header)) {
    return false;
  }
  wire_get_header(header, &frame->header);
  frame->payload = malloc(frame->header.payload_bytes + 1);
  if (frame->payload != NULL && receive_bytes(fd, frame->payload, frame->header.payload_bytes)) {
    return true;
  }
  free(frame->payload);
  return false;
}

bool peer_send_bytes(int fd, const void *bytes, size_t count) {
  const char *at = bytes;
  while (count > 0) {
    const ssize_t sent = send(fd, at, count, MSG_NOSIGNAL);
    if (sent <= 0) {
      return false;
    }
    at += sent;
    count -= (size_t)sent;
  }
  return true;
}

bool peer_send(int fd, uint16_t type, uint64_t id, const void *payload, size_t payload_bytes) {
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = type,
                              .request_id = id,
                              .payload_bytes = (uint32_t)payload_bytes};
  uint8_t bytes[WIRE_BYTES_header];
  wire_put_header(bytes, &header);
  return peer_send_bytes(fd, bytes, sizeof bytes) && peer_send_bytes(fd, payload, payload_bytes);
}

bool peer_say_hello(int fd) {
  uint8_t payload[WIRE_BYTES_hello_reply + 2 * WIRE_BYTES_choice];
  wire_hello_reply reply = {.version = WIRE_VERSION,
                            .version_min = WIRE_VERSION,
                            .version_max = WIRE_VERSION,
                            .workers = 1,
                            .choice_count = 2};
  wire_choice model = {.kind = WIRE_CHOICE_MODEL, .id = 2};
  wire_choice status = {.kind = WIRE_CHOICE_STATUS, .id = WIRE_STATUS_BAD_VALUE};
  peer_frame request;
  WIRE_SET_TEXT(reply.software, "scripted\033[31m");
  WIRE_SET_TEXT(reply.instruction_set, "avx\n2");
  WIRE_SET_TEXT(reply.R_unit, "1/mm^2\177");
  WIRE_SET_TEXT(model.name, "better");
  WIRE_SET_TEXT(model.about, "half\rspaces");
  WIRE_SET_TEXT(status.name, "bad-value");
  wire_put_hello_reply(payload, &reply);
  wire_put_choice(payload + WIRE_BYTES_hello_reply, &model);
  wire_put_choice(payload + WIRE_BYTES_hello_reply + WIRE_BYTES_choice, &status);
  if (!peer_receive(fd, &request)) {
    return false;
  }
  free(request.payload);
  return peer_send(fd, WIRE_TYPE_HELLO | WIRE_REPLY, request.header.request_id, payload,
                   sizeof payload);
}

/* Writes factor times each of the radii number first, first + 1, ... */
static void put_values(uint8_t *to, const eval_request *request, uint64_t first, uint64_t count,
                       double factor) {
  for (uint64_t i = 0; i < count; i++) {
    if (request->radii == NULL && request->fixed.evaluator == CORE_EVALUATOR_F64) {
      ((double *)to)[i] = (double)(first + i);
    } else if (request->radii == NULL) {
      ((float *)to)[i] = (float)(first + i);
    } else if (request->fixed.evaluator == CORE_EVALUATOR_F64) {
      ((double *)to)[i] = factor * ((const double *)request->radii)[first + i];
    } else {
      ((float *)to)[i] = (float)factor * ((const float *)request->radii)[first + i];
    }
  }
}

static const struct {
  enum core_quantity quantity;
  double factor;
} factors[] = {{CORE_QUANTITY_R, 2}, {CORE_QUANTITY_CDF, 0.25}, {CORE_QUANTITY_S, 3}};

static void put_channel(uint8_t *payload, const eval_layout *layout, const eval_request *request,
                        const wire_eval_reply *reply, uint32_t index) {
  const wire_quantity_error error = {
      .numerical_error = 1e-15, .model_error = request->parameters.value[CORE_PARAMETER_COS_IN]};
  memcpy(payload + eval_albedo_offset(index), &request->media[index].sigma_a_per_mm,
         sizeof(double));
  for (unsigned left = reply->wanted; left != 0; left &= left - 1) {
    wire_put_quantity_error(
        payload + eval_error_offset(layout, reply->wanted, index, left & ~(left - 1)), &error);
  }
  for (size_t i = 0; i < sizeof factors / sizeof factors[0]; i++) {
    if ((reply->wanted & factors[i].quantity) != 0) {
      const uint64_t at = eval_array_offset(layout, reply->wanted, index, factors[i].quantity);
      put_values(payload + at, request, reply->first, reply->count, factors[i].factor);
    }
  }
}

static eval_request parse(const peer_frame *frame) {
  eval_request request;
  if (eval_request_parse(frame->payload, frame->header.payload_bytes, &request).status !=
      WIRE_STATUS_OK) {
    abort(); /* The library makes only well-formed requests. */
  }
  return request;
}

size_t peer_evaluate_part(const peer_frame *frame, uint64_t radius_first, uint64_t radius_count,
                          uint32_t part, uint32_t part_count, uint8_t **payload) {
  const eval_request request = parse(frame);
  const wire_eval_request *fixed = &request.fixed;
  const wire_eval_reply reply = {.model = fixed->model,
                                 .evaluator = fixed->evaluator,
                                 .moments = fixed->moments,
                                 .wanted = fixed->wanted,
                                 .notes = fixed->parameter_count,
                                 .channel_count = fixed->medium_count,
                                 .count = radius_count,
                                 .first = radius_first,
                                 .part = part,
                                 .part_count = part_count};
  eval_layout layout;
  if (!eval_reply_layout(fixed->evaluator, fixed->wanted, fixed->medium_count, radius_count,
                         UINT32_MAX, &layout)) {
    abort();
  }
  uint8_t *at = calloc(1, layout.payload_bytes);
  if (at == NULL) {
    abort();
  }
  *payload = at;
  wire_put_eval_reply(at, &reply);
  if ((fixed->wanted & CORE_QUANTITY_RADIUS) != 0) {
    put_values(at + layout.radius_offset, &request, radius_first, radius_count, 1);
  }
  for (uint32_t i = 0; i < fixed->medium_count; i++) {
    put_channel(at, &layout, &request, &reply, i);
  }
  return layout.payload_bytes;
}

size_t peer_evaluate(const peer_frame *frame, uint8_t **payload) {
  return peer_evaluate_part(frame, 0, parse(frame).fixed.radius_count, 0, 1, payload);
}

void peer_serve(int fd, void *context) {
  peer_frame request;
  (void)context;
  bool good = peer_say_hello(fd);
  while (good && peer_receive(fd, &request)) {
    uint8_t *payload;
    const size_t bytes = peer_evaluate(&request, &payload);
    good = peer_send(fd, WIRE_TYPE_EVAL | WIRE_REPLY, request.header.request_id, payload, bytes);
    free(payload);
    free(request.payload);
  }
}
