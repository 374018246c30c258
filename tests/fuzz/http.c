/* The target for requests over HTTP: queries and JSON texts, and the payloads that they become. */
#include <jansson.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/reply.h"
#include "server/http/request.h"
#include "tests/fuzz/daemon.h"

enum { PAYLOAD = 65536, BODY = 1, MESSAGES_AT = 2 };

/* Returns a message that HTTP has. */
static const schema_message *choose(unsigned number) {
  const schema_message *message = schema_messages;
  for (unsigned i = 0; i < number || message->about == NULL;) {
    i += message->about != NULL;
    message = message[1].type != 0 ? message + 1 : schema_messages;
  }
  return message;
}

/* Writes an error, and checks that it is JSON and names what is allowed. */
static void check_error(const wire_error *error) {
  struct text text;
  text_init(&text, &fuzz_server.buffers);
  CHECK(error->allowed[0] != '\0' && error->field[0] != '\0');
  CHECK(http_reply_write_error(error, &text) >= 400);
  json_t *object = json_loadb(text.bytes, text.count, JSON_REJECT_DUPLICATES, NULL);
  CHECK(json_is_object(object));
  json_decref(object);
  text_free(&text);
}

/* The first byte of an input says whether it is a query or a body, and the second which request. */
void fuzz_http(const uint8_t *data, size_t size) {
  if (size < MESSAGES_AT) {
    return;
  }
  const bool is_body = (data[0] & BODY) != 0;
  const schema_message *message = choose(data[1]);
  const uint64_t before = atomic_load(&fuzz_server.buffers.bytes);
  struct text payload;
  uint32_t deadline_ms;
  bool g_is_default;
  text_init(&payload, &fuzz_server.buffers);
  char *text = malloc(size);
  CHECK(text != NULL);
  memcpy(text, data + MESSAGES_AT, size - MESSAGES_AT);
  text[size - MESSAGES_AT] = '\0';
  wire_error error = http_request_translate(message, text, size - MESSAGES_AT, !is_body, &payload,
                                            PAYLOAD, &deadline_ms, &g_is_default);
  if (error.status == WIRE_STATUS_OK) {
    CHECK(payload.count % WIRE_ALIGNMENT == 0 && payload.count <= PAYLOAD);
    uint8_t *copy = fuzz_copy((const uint8_t *)payload.bytes, payload.count);
    schema_layout layout;
    error = schema_check(message->request, copy, payload.count, &layout);
    free(copy);
  }
  if (error.status != WIRE_STATUS_OK) {
    check_error(&error);
  }
  text_free(&payload);
  free(text);
  CHECK(atomic_load(&fuzz_server.buffers.bytes) == before);
}
