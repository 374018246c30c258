/* What the daemon tells of itself: hello, measured media, statistics, ping. */
#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"

/* The longest list that is believed: no daemon has thousands of models or media. */
#define LIST_MAX_BYTES ((uint64_t)1 << 20)

static bool bad_list(dipole_client *client, const char *what, dipole_error *error) {
  libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                 "the peer does not speak this protocol: its %s does not have the length that it "
                 "announces",
                 what);
  client->broken = *error;
  return false;
}

static bool no_memory(dipole_error *error) {
  return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
}

/* ---- hello --------------------------------------------------------------------------------- */

static bool get_choices(dipole_client *client, const uint8_t *at, size_t count) {
  client->choices = calloc(count + 1, sizeof *client->choices);
  client->choice_texts = calloc(count + 1, sizeof *client->choice_texts);
  if (client->choices == NULL || client->choice_texts == NULL) {
    return false;
  }
  for (size_t i = 0; i < count; i++) {
    wire_choice *from = &client->choice_texts[i];
    wire_get_choice(at + i * WIRE_BYTES_choice, from);
    libdipole_clean_text(from->name);
    libdipole_clean_text(from->about);
    client->choices[i] = (dipole_choice){.kind = (enum dipole_kind)from->kind,
                                         .id = from->id,
                                         .name = from->name,
                                         .about = from->about};
  }
  return true;
}

static void get_value(const uint8_t *at, wire_value *text, dipole_value *value) {
  wire_get_value(at, text);
  libdipole_clean_text(text->name);
  *value = (dipole_value){.name = text->name, .value = text->value};
}

static bool get_limits(dipole_client *client, const uint8_t *at, size_t count) {
  client->limits = calloc(count + 1, sizeof *client->limits);
  client->limit_texts = calloc(count + 1, sizeof *client->limit_texts);
  if (client->limits == NULL || client->limit_texts == NULL) {
    return false;
  }
  for (size_t i = 0; i < count; i++) {
    get_value(at + i * WIRE_BYTES_value, &client->limit_texts[i], &client->limits[i]);
  }
  return true;
}

/* The lists are at most LIST_MAX_BYTES, so that no product of counts can wrap. */
static bool get_hello(dipole_client *client, const libdipole_frame *frame, dipole_error *error) {
  wire_hello_reply *hello = &client->hello;
  const size_t bytes = frame->header.payload_bytes - WIRE_BYTES_hello_reply;
  wire_get_hello_reply(frame->payload, hello);
  if (hello->choice_count > bytes / WIRE_BYTES_choice ||
      hello->limit_count > bytes / WIRE_BYTES_value ||
      bytes != (size_t)hello->choice_count * WIRE_BYTES_choice +
                   (size_t)hello->limit_count * WIRE_BYTES_value) {
    return bad_list(client, "hello", error);
  }
  if (hello->version != WIRE_VERSION) {
    return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                          "the daemon speaks protocol versions %u to %u, this library version %d",
                          hello->version_min, hello->version_max, WIRE_VERSION);
  }
  const uint8_t *at = frame->payload + WIRE_BYTES_hello_reply;
  if (!get_choices(client, at, hello->choice_count) ||
      !get_limits(client, at + (size_t)hello->choice_count * WIRE_BYTES_choice,
                  hello->limit_count)) {
    return no_memory(error);
  }
  libdipole_clean_text(hello->software);
  libdipole_clean_text(hello->instruction_set);
  libdipole_clean_text(hello->R_unit);
  client->info = (dipole_info){.address = client->address,
                               .software = hello->software,
                               .instruction_set = hello->instruction_set,
                               .R_unit = hello->R_unit,
                               .protocol_version = hello->version,
                               .workers = hello->workers,
                               .choices = client->choices,
                               .choice_count = hello->choice_count,
                               .limits = client->limits,
                               .limit_count = hello->limit_count};
  return true;
}

bool libdipole_hello(dipole_client *client, dipole_error *error) {
  const wire_hello_request hello = {.version_min = WIRE_VERSION, .version_max = WIRE_VERSION};
  uint8_t payload[WIRE_BYTES_hello_request];
  libdipole_pending pending = {.type = WIRE_TYPE_HELLO,
                               .reply_bytes_min = WIRE_BYTES_hello_reply,
                               .reply_bytes_max = LIST_MAX_BYTES};
  wire_put_hello_request(payload, &hello);
  libdipole_frame *frame = libdipole_ask(client, &pending, payload, sizeof payload, error);
  const bool understood = frame != NULL && get_hello(client, frame, error);
  free(frame);
  return understood;
}

void libdipole_info_free(dipole_client *client) {
  free(client->choices);
  free(client->choice_texts);
  free(client->limits);
  free(client->limit_texts);
  free(client->address);
}

const dipole_info *dipole_get_info(const dipole_client *client) {
  return &client->info;
}

unsigned dipole_id(const dipole_client *client, enum dipole_kind kind, const char *name) {
  for (size_t i = 0; i < client->info.choice_count; i++) {
    const dipole_choice *choice = &client->info.choices[i];
    if (choice->kind == kind && strcmp(choice->name, name) == 0) {
      return choice->id;
    }
  }
  return 0;
}

/* ---- lists --------------------------------------------------------------------------------- */

/* Asks for a list of structures of one size; *count of them lie behind the list_reply. */
static libdipole_frame *ask_list(dipole_client *client, enum wire_type type, size_t structure_bytes,
                                 size_t *count, dipole_error *error) {
  wire_list_reply list;
  libdipole_pending pending = {.type = (uint16_t)type,
                               .reply_bytes_min = WIRE_BYTES_list_reply,
                               .reply_bytes_max = LIST_MAX_BYTES};
  libdipole_frame *frame = libdipole_ask(client, &pending, NULL, 0, error);
  if (frame == NULL) {
    return NULL;
  }
  const size_t bytes = frame->header.payload_bytes - WIRE_BYTES_list_reply;
  wire_get_list_reply(frame->payload, &list);
  if (bytes % structure_bytes != 0 || bytes / structure_bytes != list.count) {
    bad_list(client, wire_type_name(type), error);
    free(frame);
    return NULL;
  }
  *count = list.count;
  return frame;
}

static void get_measured_medium(const uint8_t *at, dipole_measured_medium *medium) {
  wire_measured_medium from;
  wire_get_measured_medium(at, &from);
  libdipole_clean_text(from.name);
  _Static_assert(sizeof medium->name == sizeof from.name, "name");
  memcpy(medium->name, from.name, sizeof from.name);
  for (size_t i = 0; i < sizeof medium->channel / sizeof medium->channel[0]; i++) {
    medium->channel[i] = (dipole_medium){.sigma_a_per_mm = from.sigma_a[i],
                                         .sigma_s_per_mm = from.sigma_s[i],
                                         .g = from.g,
                                         .eta = from.eta};
  }
}

bool dipole_media(dipole_client *client, dipole_measured_medium **media, size_t *count,
                  dipole_error *error) {
  dipole_error unwanted;
  error = error != NULL ? error : &unwanted;
  libdipole_frame *frame =
      ask_list(client, WIRE_TYPE_MEDIA, WIRE_BYTES_measured_medium, count, error);
  if (frame == NULL) {
    return false;
  }
  *media = calloc(*count + 1, sizeof **media); /* never NULL for an empty list */
  for (size_t i = 0; *media != NULL && i < *count; i++) {
    get_measured_medium(frame->payload + WIRE_BYTES_list_reply + i * WIRE_BYTES_measured_medium,
                        &(*media)[i]);
  }
  free(frame);
  return *media != NULL || no_memory(error);
}

bool dipole_statistics(dipole_client *client, dipole_value **values, size_t *count,
                       dipole_error *error) {
  dipole_error unwanted;
  error = error != NULL ? error : &unwanted;
  libdipole_frame *frame = ask_list(client, WIRE_TYPE_STATS, WIRE_BYTES_value, count, error);
  if (frame == NULL) {
    return false;
  }
  /* One block: the values, then the texts that they point to. */
  *values = calloc(*count + 1, sizeof **values + sizeof(wire_value));
  wire_value *texts = *values != NULL ? (wire_value *)(*values + *count) : NULL;
  for (size_t i = 0; *values != NULL && i < *count; i++) {
    get_value(frame->payload + WIRE_BYTES_list_reply + i * WIRE_BYTES_value, &texts[i],
              &(*values)[i]);
  }
  free(frame);
  return *values != NULL || no_memory(error);
}

bool dipole_ping(dipole_client *client, dipole_error *error) {
  static const uint8_t payload[8] = {'d', 'i', 'p', 'o', 'l', 'e', '?', '\n'};
  dipole_error unwanted;
  libdipole_pending pending = {
      .type = WIRE_TYPE_PING, .reply_bytes_min = sizeof payload, .reply_bytes_max = sizeof payload};
  error = error != NULL ? error : &unwanted;
  libdipole_frame *frame = libdipole_ask(client, &pending, payload, sizeof payload, error);
  if (frame == NULL) {
    return false;
  }
  const bool same = memcmp(frame->payload, payload, sizeof payload) == 0;
  free(frame);
  if (!same) {
    libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                   "the peer does not speak this protocol: a ping came back changed");
    client->broken = *error;
  }
  return same;
}
