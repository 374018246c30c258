/* What could answer a query: models and evaluators with their measured error and cost. */
#include <stdlib.h>

#include "clients/c/client.h"

/* The longest list that is believed: no daemon has thousands of models. */
#define OFFERS_MAX_BYTES ((uint64_t)1 << 20)

static bool bad_answer(dipole_client *client, dipole_error *error) {
  libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                 "the peer does not speak this protocol: its offers do not have the length that "
                 "they announce");
  client->broken = *error;
  return false;
}

static dipole_offer get_offer(const uint8_t *at) {
  wire_offer from;
  wire_get_offer(at, &from);
  return (dipole_offer){.model = from.model,
                        .evaluator = from.evaluator,
                        .meets = from.meets != 0,
                        .error = from.error,
                        .numerical_error = from.numerical_error,
                        .cost_ns = from.cost,
                        .prepare_ns = from.prepare_cost};
}

/* At most OFFERS_MAX_BYTES, so that no product of counts can wrap. */
static bool get_offers(dipole_client *client, const libdipole_frame *frame, dipole_offer **offers,
                       size_t *count, size_t *taken, dipole_error *error) {
  wire_offers_reply fixed;
  const size_t bytes = frame->header.payload_bytes - WIRE_BYTES_offers_reply;
  wire_get_offers_reply(frame->payload, &fixed);
  if (bytes % WIRE_BYTES_offer != 0 || bytes / WIRE_BYTES_offer != fixed.count ||
      fixed.taken > fixed.count) {
    return bad_answer(client, error);
  }
  *offers = calloc((size_t)fixed.count + 1, sizeof **offers); /* never NULL for an empty list */
  if (*offers == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
  }
  for (size_t i = 0; i < fixed.count; i++) {
    (*offers)[i] = get_offer(frame->payload + WIRE_BYTES_offers_reply + i * WIRE_BYTES_offer);
  }
  *count = fixed.count;
  if (taken != NULL) {
    *taken = fixed.taken;
  }
  return true;
}

bool dipole_offers(dipole_client *client, const dipole_query *query, dipole_offer **offers,
                   size_t *count, size_t *taken, dipole_error *error) {
  dipole_error unwanted;
  libdipole_pending pending = {.type = WIRE_TYPE_OFFERS,
                               .reply_bytes_min = WIRE_BYTES_offers_reply,
                               .reply_bytes_max = OFFERS_MAX_BYTES};
  error = error != NULL ? error : &unwanted;
  if (!libdipole_query_send(client, query, &pending, error)) {
    return false;
  }
  libdipole_frame *frame = libdipole_reply(client, &pending, error);
  const bool good = frame != NULL && get_offers(client, frame, offers, count, taken, error);
  free(frame);
  return good;
}
