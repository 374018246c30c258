#include "clients/cli/top_record.h"

#include <stdio.h>
#include <string.h>

static uint64_t find(const top_look *look, const char *name) {
  for (size_t i = 0; i < look->count; i++) {
    if (strcmp(look->values[i].name, name) == 0) {
      return look->values[i].value;
    }
  }
  return 0;
}

uint64_t top_value(const top_record *record, const char *name) {
  return find(&record->now, name);
}

static uint64_t rise(const top_record *record, const char *name) {
  const uint64_t before = find(&record->before, name);
  const uint64_t now = find(&record->now, name);
  return now > before ? now - before : 0;
}

double top_rate(const top_record *record, const char *name) {
  return record->interval_s > 0 ? (double)rise(record, name) / record->interval_s : 0;
}

bool top_next(const top_record *record, const char *prefix, size_t *from, const char **rest) {
  const size_t length = strlen(prefix);
  while (*from < record->now.count) {
    const char *name = record->now.values[(*from)++].name;
    if (strncmp(name, prefix, length) == 0) {
      *rest = name + length;
      return true;
    }
  }
  return false;
}

double top_requests_rate(const top_record *record) {
  double rate = 0;
  const char *rest;
  for (size_t from = 0; top_next(record, "requests_", &from, &rest);) {
    rate += top_rate(record, record->now.values[from - 1].name);
  }
  return rate;
}

double top_errors_rate(const top_record *record) {
  double rate = 0;
  const char *rest;
  for (size_t from = 0; top_next(record, "answers_", &from, &rest);) {
    rate += strcmp(rest, "ok") == 0 ? 0 : top_rate(record, record->now.values[from - 1].name);
  }
  return rate;
}

double top_batch_mean(const top_record *record) {
  const uint64_t batches = rise(record, "batches_evaluated");
  return batches > 0 ? (double)rise(record, "batched_requests") / (double)batches : 0;
}

bool top_next_latency(const top_record *record, size_t *from, char *kind, size_t bytes) {
  static const char suffix[] = "_count";
  const char *rest;
  while (top_next(record, "latency_", from, &rest)) {
    const size_t length = strlen(rest);
    if (length > strlen(suffix) && strcmp(rest + length - strlen(suffix), suffix) == 0) {
      snprintf(kind, bytes, "%.*s", (int)(length - strlen(suffix)), rest);
      return true;
    }
  }
  return false;
}

uint64_t top_latency(const top_record *record, const char *kind, const char *what) {
  char name[96];
  snprintf(name, sizeof name, "latency_%s_%s", kind, what);
  return top_value(record, name);
}
