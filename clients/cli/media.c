/* dipole media: the measured media that the daemon knows. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/cli.h"
#include "clients/cli/json.h"
#include "clients/cli/number.h"
#include "clients/cli/table.h"

static const char *const channels[] = {"red", "green", "blue"};

enum { CHANNELS = sizeof channels / sizeof channels[0] };

static void write_table(const dipole_measured_medium *media, size_t count) {
  static const char *const head[] = {"medium", "channel", "sigma_a", "sigma_s", "g", "eta",
                                     "",       "",        "1/mm",    "1/mm",    "",  ""};
  cli_table table = {.columns = 6, .left = 2, .heads = 2};
  for (size_t i = 0; i < sizeof head / sizeof head[0]; i++) {
    cli_table_add(&table, "%s", head[i]);
  }
  for (size_t i = 0; i < count * CHANNELS; i++) {
    const dipole_medium *medium = &media[i / CHANNELS].channel[i % CHANNELS];
    cli_table_add(&table, "%s", i % CHANNELS == 0 ? media[i / CHANNELS].name : "");
    cli_table_add(&table, "%s", channels[i % CHANNELS]);
    cli_table_add(&table, "%.6g", medium->sigma_a_per_mm);
    cli_table_add(&table, "%.6g", medium->sigma_s_per_mm);
    cli_table_add(&table, "%.6g", medium->g);
    cli_table_add(&table, "%.6g", medium->eta);
  }
  cli_table_print(&table, stdout);
}

static void write_csv(const dipole_measured_medium *media, size_t count) {
  char a[CLI_NUMBER_BYTES], s[CLI_NUMBER_BYTES], g[CLI_NUMBER_BYTES], eta[CLI_NUMBER_BYTES];
  puts("medium,channel,sigma_a,sigma_s,g,eta");
  for (size_t i = 0; i < count * CHANNELS; i++) {
    const dipole_medium *medium = &media[i / CHANNELS].channel[i % CHANNELS];
    printf("%s,%s,%s,%s,%s,%s\n", media[i / CHANNELS].name, channels[i % CHANNELS],
           cli_number_format(medium->sigma_a_per_mm, a),
           cli_number_format(medium->sigma_s_per_mm, s), cli_number_format(medium->g, g),
           cli_number_format(medium->eta, eta));
  }
}

static void write_json(const dipole_measured_medium *media, size_t count) {
  cli_json json = {.file = stdout};
  cli_json_begin(&json, NULL, '{');
  cli_json_begin(&json, "units", '{');
  cli_json_text(&json, "sigma_a", "1/mm");
  cli_json_text(&json, "sigma_s", "1/mm");
  cli_json_end(&json, '}');
  cli_json_begin(&json, "media", '[');
  for (size_t i = 0; i < count; i++) {
    cli_json_begin(&json, NULL, '{');
    cli_json_text(&json, "medium", media[i].name);
    cli_json_begin(&json, "channels", '[');
    for (size_t c = 0; c < CHANNELS; c++) {
      const dipole_medium *medium = &media[i].channel[c];
      cli_json_begin(&json, NULL, '{');
      cli_json_text(&json, "channel", channels[c]);
      cli_json_number(&json, "sigma_a", medium->sigma_a_per_mm);
      cli_json_number(&json, "sigma_s", medium->sigma_s_per_mm);
      cli_json_number(&json, "g", medium->g);
      cli_json_number(&json, "eta", medium->eta);
      cli_json_end(&json, '}');
    }
    cli_json_end(&json, ']');
    cli_json_end(&json, '}');
  }
  cli_json_end(&json, ']');
  cli_json_end(&json, '}');
}

static int list_media(const cli_command *command, const char *format, dipole_client *client) {
  dipole_measured_medium *media;
  dipole_error error;
  size_t count;
  if (!dipole_media(client, &media, &count, &error)) {
    return cli_fail(command, "%s", error.text);
  }
  if (format == NULL || strcmp(format, "table") == 0) {
    write_table(media, count);
  } else if (strcmp(format, "csv") == 0) {
    write_csv(media, count);
  } else {
    write_json(media, count);
  }
  free(media);
  return CLI_OK;
}

static int run(const cli_command *command, int argc, char **argv) {
  return cli_run_plain(command, argc, argv, list_media);
}

static const cli_option options[] = {{0}};

const cli_command cli_command_media = {
    .name = "media",
    .about = "List the measured media and their coefficients",
    .more = "\n"
            "Only sigma_s (1 - g) was measured; sigma_s holds it, with g = 0.\n",
    .formats = "table,csv,json",
    .options = options,
    .examples = "  dipole media\n"
                "  dipole media --format csv\n",
    .run = run,
};
