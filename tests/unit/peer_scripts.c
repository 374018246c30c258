#include "tests/unit/peer_scripts.h"

#include <stdlib.h>
#include <string.h>

void peer_receive_or_abort(int fd, peer_frame *request) {
  if (!peer_receive(fd, request)) {
    abort();
  }
}

void peer_say_hello_or_abort(int fd) {
  if (!peer_say_hello(fd)) {
    abort();
  }
}

void peer_send_error(int fd, uint64_t id, enum wire_status status, uint32_t retry_after_ms) {
  const wire_error error = {.status = (uint16_t)status, .retry_after_ms = retry_after_ms};
  uint8_t payload[WIRE_BYTES_error];
  wire_put_error(payload, &error);
  peer_send(fd, WIRE_TYPE_ERROR, id, payload, sizeof payload);
}

void peer_answer(int fd, const peer_frame *request) {
  uint8_t *payload;
  const size_t bytes = peer_evaluate(request, &payload);
  peer_send(fd, WIRE_TYPE_EVAL | WIRE_REPLY, request->header.request_id, payload, bytes);
  free(payload);
}

void peer_hang_up_at_once(int fd, void *context) {
  (void)fd;
  (void)context;
}

void peer_hang_up_after_hello(int fd, void *context) {
  (void)context;
  peer_say_hello_or_abort(fd);
}

void peer_hang_up_after_request(int fd, void *context) {
  peer_frame request;
  (void)context;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  free(request.payload);
}

void peer_hang_up_in_answer(int fd, void *context) {
  peer_frame request;
  uint8_t *payload;
  peer_say_hello_or_abort(fd);
  peer_receive_or_abort(fd, &request);
  const size_t payload_bytes = peer_evaluate(&request, &payload);
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_EVAL | WIRE_REPLY,
                              .request_id = request.header.request_id,
                              .payload_bytes = (uint32_t)payload_bytes};
  uint8_t *bytes = malloc(WIRE_BYTES_header + payload_bytes);
  if (bytes == NULL) {
    abort();
  }
  wire_put_header(bytes, &header);
  memset(bytes + WIRE_BYTES_header, 0xff, payload_bytes); /* none of it may ever be used */
  peer_send_bytes(fd, bytes, *(const size_t *)context);
  free(bytes);
  free(payload);
  free(request.payload);
}

void peer_be_full(int fd, void *context) {
  (void)context;
  peer_send_error(fd, 0, WIRE_STATUS_BUSY, 30);
}
