#include "server/observe/metrics_text.h"

#include <stdio.h>
#include <stdlib.h>

#include "server/observe/report.h"
#include "server/server.h"

struct text {
  FILE *file;
  const struct report_family *family; /* whose values are being written */
};

static void start_family(struct text *text, const struct report_value *value) {
  static const char *const types[] = {
      [REPORT_COUNTER] = "counter",
      [REPORT_GAUGE] = "gauge",
      [REPORT_SUMMARY] = "summary",
      [REPORT_HISTOGRAM] = "histogram",
  };
  const struct report_family *family = value->family;
  /* A counter's family has the name of its values in this version of the format. */
  const char *suffix = family->type == REPORT_COUNTER ? value->suffix : "";
  fprintf(text->file, "# HELP dipoled_%s%s %s\n# TYPE dipoled_%s%s %s\n", family->name, suffix,
          family->help, family->name, suffix, types[family->type]);
  text->family = family;
}

static void write_value(void *context, const struct report_value *value) {
  struct text *text = context;
  if (value->family != text->family) {
    start_family(text, value);
  }
  fprintf(text->file, "dipoled_%s%s", value->family->name, value->suffix);
  if (value->labels[0] != '\0') {
    fprintf(text->file, "{%s}", value->labels);
  }
  if (value->is_ns) {
    fprintf(text->file, " %.9f\n", (double)value->value / 1e9);
  } else {
    fprintf(text->file, " %llu\n", (unsigned long long)value->value);
  }
}

char *metrics_text(const struct server *server, size_t *bytes) {
  char *memory = NULL;
  struct text text = {open_memstream(&memory, bytes), NULL};
  if (text.file == NULL) {
    return NULL;
  }
  report_each(server, write_value, &text);
  const int failed = ferror(text.file);
  if (fclose(text.file) != 0 || failed != 0) {
    free(memory);
    return NULL;
  }
  return memory;
}
