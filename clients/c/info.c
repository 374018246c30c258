/* Requests a daemon's description, its measured media and its statistics. */

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/request.h"
#include "core/core.h"

/* The longest list that the library accepts. It is far more than a daemon has, and small enough
 * that no product of counts overflows. */
#define LIST_MAX_BYTES ((uint64_t)1 << 20)

/* ---- lists of choices ---------------------------------------------------------------------- */

/* A block of memory that holds an info and everything that the info points to. */
typedef struct info_block {
  dipole_info info;
  wire_hello_reply hello;
  wire_choice *choice_texts;
  wire_value *limit_texts;
  dipole_choice *choices;
  dipole_value *limits;
} info_block;

/* Allocates an info with room for lists of these lengths, and copies the address into it. */
static info_block *new_block(size_t choice_count, size_t limit_count, const char *address,
                             dipole_error *error) {
  const size_t address_bytes = strlen(address) + 1;
  const size_t bytes = sizeof(info_block) +
                       choice_count * (sizeof(dipole_choice) + sizeof(wire_choice)) +
                       limit_count * (sizeof(dipole_value) + sizeof(wire_value)) + address_bytes;
  info_block *block = calloc(1, bytes);
  if (block == NULL) {
    libdipole_fail_memory(error);
    return NULL;
  }
  block->choices = (dipole_choice *)(void *)(block + 1);
  block->limits = (dipole_value *)(void *)(block->choices + choice_count);
  block->limit_texts = (wire_value *)(void *)(block->limits + limit_count);
  block->choice_texts = (wire_choice *)(void *)(block->limit_texts + limit_count);
  char *copy = (char *)(block->choice_texts + choice_count);
  assert(copy + address_bytes == (char *)block + bytes);
  memcpy(copy, address, address_bytes);
  block->info = (dipole_info){.address = copy,
                              .choices = block->choices,
                              .choice_count = choice_count,
                              .limits = block->limits,
                              .limit_count = limit_count};
  return block;
}

static void set_choice(info_block *block, size_t i) {
  const wire_choice *text = &block->choice_texts[i];
  block->choices[i] = (dipole_choice){.kind = (enum dipole_kind)text->kind,
                                      .id = text->id,
                                      .name = text->name,
                                      .about = text->about};
}

bool dipole_local_info(dipole_info **info, dipole_error *error) {
  const size_t count = wire_choice_count();
  info_block *block = new_block(count, 0, "", error != NULL ? error : &(dipole_error){0});
  if (block == NULL) {
    return false;
  }
  for (size_t i = 0; i < count; i++) {
    block->choice_texts[i] = wire_choice_at(i);
    set_choice(block, i);
  }
  block->info.software = "libdipole " DIPOLED_VERSION;
  block->info.instruction_set = core_isa_name(core_isa_select(NULL));
  block->info.R_unit = WIRE_R_UNIT;
  block->info.protocol_version = WIRE_VERSION;
  *info = &block->info;
  return true;
}

/* ---- hello --------------------------------------------------------------------------------- */

static void get_value(const uint8_t *at, wire_value *text, dipole_value *value) {
  wire_get_value(at, text);
  libdipole_clean_text(text->name);
  *value = (dipole_value){.name = text->name, .value = text->value};
}

static bool take_hello(dipole_client *client, const libdipole_frame *frame, const char *address,
                       dipole_error *error) {
  wire_hello_reply hello;
  schema_layout layout;
  wire_get_hello_reply(frame->payload, &hello);
  if (!schema_is_whole(&schema_hello_reply, frame->payload, frame->payload_bytes, &layout)) {
    return libdipole_bad_reply(client, "a hello of another length than it announces", error);
  }
  if (hello.version != WIRE_VERSION) {
    return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                          "the daemon speaks the protocol's versions %u to %u, this library only "
                          "version %d: use the library of the daemon's release",
                          hello.version_min, hello.version_max, WIRE_VERSION);
  }
  info_block *block = new_block(hello.choice_count, hello.limit_count, address, error);
  if (block == NULL) {
    return false;
  }
  const uint8_t *at = frame->payload + WIRE_BYTES_hello_reply;
  for (size_t i = 0; i < hello.choice_count; i++, at += WIRE_BYTES_choice) {
    wire_get_choice(at, &block->choice_texts[i]);
    libdipole_clean_text(block->choice_texts[i].name);
    libdipole_clean_text(block->choice_texts[i].about);
    set_choice(block, i);
  }
  for (size_t i = 0; i < hello.limit_count; i++, at += WIRE_BYTES_value) {
    get_value(at, &block->limit_texts[i], &block->limits[i]);
  }
  libdipole_clean_text(hello.software);
  libdipole_clean_text(hello.instruction_set);
  libdipole_clean_text(hello.R_unit);
  block->hello = hello;
  block->info.software = block->hello.software;
  block->info.instruction_set = block->hello.instruction_set;
  block->info.R_unit = block->hello.R_unit;
  block->info.protocol_version = hello.version;
  block->info.workers = hello.workers;
  client->info = &block->info;
  return true;
}

bool libdipole_hello(dipole_client *client, const char *address, dipole_error *error) {
  static const libdipole_kind kind = {.repeatable = false};
  const wire_hello_request hello = {.version_min = WIRE_VERSION, .version_max = WIRE_VERSION};
  uint8_t payload[WIRE_BYTES_hello_request];
  libdipole_pending pending = {.kind = &kind,
                               .type = WIRE_TYPE_HELLO,
                               .reply_bytes_min = WIRE_BYTES_hello_reply,
                               .reply_bytes_max = LIST_MAX_BYTES};
  wire_put_hello_request(payload, &hello);
  libdipole_frame *frame = libdipole_call(client, &pending, payload, sizeof payload, error);
  const bool understood = frame != NULL && take_hello(client, frame, address, error);
  free(frame);
  return understood;
}

const dipole_info *dipole_get_info(const dipole_client *client) {
  return client->info;
}

unsigned dipole_id(const dipole_client *client, enum dipole_kind kind, const char *name) {
  for (size_t i = 0; i < client->info->choice_count; i++) {
    const dipole_choice *choice = &client->info->choices[i];
    if (choice->kind == kind && strcmp(choice->name, name) == 0) {
      return choice->id;
    }
  }
  return 0;
}

/* ---- lists --------------------------------------------------------------------------------- */

/* Adds a layer to the medium of its name, which is the last one, or begins a medium with it. A layer
 * beyond CORE_LAYERS_MAX is left out. */
static void add_layer(const uint8_t *at, dipole_measured_medium *media, size_t *count) {
  wire_measured_medium from;
  dipole_medium all[3][CORE_LAYERS_MAX] = {0};
  wire_get_measured_medium(at, &from);
  libdipole_clean_text(from.name);
  *count += *count == 0 || strcmp(media[*count - 1].name, from.name) != 0;
  dipole_measured_medium *medium = &media[*count - 1];
  const size_t layers = medium->layer_count;
  _Static_assert(sizeof medium->name == sizeof from.name, "name");
  memcpy(medium->name, from.name, sizeof from.name);
  if (layers == CORE_LAYERS_MAX) {
    return;
  }
  for (size_t i = 0; i < 3; i++) {
    memcpy(all[i], &medium->channel[i * layers], layers * sizeof all[0][0]);
    all[i][layers] = (dipole_medium){from.sigma_a[i], from.sigma_s[i], from.g[i], from.eta[i],
                                     from.thickness[i]};
  }
  medium->layer_count++;
  for (size_t i = 0; i < 3; i++) {
    memcpy(&medium->channel[i * (layers + 1)], all[i], (layers + 1) * sizeof all[0][0]);
  }
}

bool dipole_media(dipole_client *client, dipole_measured_medium **media, size_t *count,
                  dipole_error *error) {
  dipole_reply *reply;
  uint64_t layers;
  if (!dipole_call(client, "media", NULL, 0, 0, &reply, error)) {
    return false;
  }
  const uint8_t *at = dipole_reply_array(reply, "media", &layers);
  *count = 0;
  *media = calloc(layers + 1, sizeof **media); /* so that *media is not NULL for an empty list */
  for (size_t i = 0; *media != NULL && i < layers; i++) {
    add_layer(at + i * WIRE_BYTES_measured_medium, *media, count);
  }
  dipole_reply_free(reply);
  return *media != NULL || libdipole_fail_memory(error != NULL ? error : &(dipole_error){0});
}

bool dipole_statistics(dipole_client *client, dipole_value **values, size_t *count,
                       dipole_error *error) {
  dipole_reply *reply;
  uint64_t listed;
  if (!dipole_call(client, "statistics", NULL, 0, 0, &reply, error)) {
    return false;
  }
  const uint8_t *at = dipole_reply_array(reply, "value", &listed);
  *count = (size_t)listed;
  /* One block holds the values and then the texts that they point to. */
  *values = calloc(*count + 1, sizeof **values + sizeof(wire_value));
  wire_value *texts = *values != NULL ? (wire_value *)(*values + *count) : NULL;
  for (size_t i = 0; *values != NULL && i < *count; i++) {
    get_value(at + i * WIRE_BYTES_value, &texts[i], &(*values)[i]);
  }
  dipole_reply_free(reply);
  return *values != NULL || libdipole_fail_memory(error != NULL ? error : &(dipole_error){0});
}

bool dipole_ping(dipole_client *client, dipole_error *error) {
  static const uint8_t payload[8] = {'d', 'i', 'p', 'o', 'l', 'e', '?', '\n'};
  libdipole_pending pending = {.kind = &libdipole_plain,
                               .type = WIRE_TYPE_PING,
                               .reply_bytes_min = sizeof payload,
                               .reply_bytes_max = sizeof payload};
  error = error != NULL ? error : &(dipole_error){0};
  libdipole_frame *frame = libdipole_call(client, &pending, payload, sizeof payload, error);
  if (frame == NULL) {
    return false;
  }
  const bool same = memcmp(frame->payload, payload, sizeof payload) == 0;
  free(frame);
  return same || libdipole_bad_reply(client, "a ping came back changed", error);
}
