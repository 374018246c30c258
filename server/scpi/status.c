#include "server/scpi/status.h"

#include <stdio.h>
#include <string.h>

static const struct {
  int number;
  const char *text;
} texts[] = {
#define SCPI_ERROR(number, IDENT, text) {number, text},
    SCPI_ERRORS(SCPI_ERROR)};

static const char *text_of(int number) {
  size_t i = 0;
  while (i + 1 < sizeof texts / sizeof texts[0] && texts[i].number != number) {
    i++;
  }
  return texts[i].text;
}

void scpi_status_set(struct scpi_register *status, uint16_t condition) {
  status->event |= (uint16_t)(condition & ~status->condition);
  status->condition = condition;
}

void scpi_status_fail(struct scpi_status *status, int number, const char *field,
                      const char *allowed) {
  static const uint8_t event_of_class[] = {0, 32, 16, 8}; /* -1xx, -2xx, -3xx */
  status->events |= event_of_class[-number / 100];
  if (status->count == SCPI_ERRORS_MAX) {
    number = SCPI_OVERFLOW;
    field = NULL;
    status->events |= event_of_class[-SCPI_OVERFLOW / 100];
  } else {
    status->count++;
  }
  char *to = status->errors[(status->first + status->count - 1) % SCPI_ERRORS_MAX];
  const int begin = snprintf(to, SCPI_ERROR_BYTES, "%d,\"", number);
  snprintf(to + begin, SCPI_ERROR_BYTES - 1 - (size_t)begin, "%s%s%s%s%s", text_of(number),
           field != NULL ? ";" : "", field != NULL ? field : "",
           field != NULL && allowed != NULL ? ": " : "", allowed != NULL ? allowed : "");
  for (char *at = to + begin; *at != '\0'; at++) {
    *at = *at == '"' || *at < ' ' || *at > '~' ? '\'' : *at;
  }
  strcat(to, "\"");
}

void scpi_status_refuse(struct scpi_status *status, const wire_error *error) {
  scpi_status_fail(status, wire_status_of(error->status)->scpi, error->field, error->allowed);
}

const char *scpi_status_take(struct scpi_status *status) {
  if (status->count == 0) {
    return "0,\"No error\"";
  }
  const char *error = status->errors[status->first];
  status->first = (status->first + 1) % SCPI_ERRORS_MAX;
  status->count--;
  return error;
}

unsigned scpi_status_byte(const struct scpi_status *status, bool answers) {
  const unsigned byte = (status->count > 0 ? 4U : 0) |
                        ((status->questionable.event & status->questionable.enable) != 0 ? 8U : 0) |
                        (answers ? 16U : 0) |
                        ((status->events & status->events_enable) != 0 ? 32U : 0) |
                        ((status->operation.event & status->operation.enable) != 0 ? 128U : 0);
  return byte | ((byte & status->service_enable & ~64U) != 0 ? 64U : 0);
}
