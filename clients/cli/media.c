/* dipole media: the measured media that the daemon knows. */
#include <stdlib.h>

#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"
#include "clients/cli/rows.h"

/* Puts one channel of a medium. */
static void put_channel(cli_rows *rows, const void *context, size_t index) {
  const dipole_measured_medium *media = context;
  const size_t channel = index % CLI_COLOURS;
  const char *name = media[index / CLI_COLOURS].name;
  cli_put_text(rows, CLI_COLUMN("medium", .forms = CLI_IN_TABLE), channel == 0 ? name : "");
  cli_put_text(rows, CLI_COLUMN("medium", .forms = CLI_IN_CSV), name);
  cli_put_text(rows, CLI_COLUMN("channel"), cli_colours[channel]);
  cli_put_medium(rows, &media[index / CLI_COLOURS].channel[channel]);
}

static void put_medium(cli_rows *rows, const void *context, size_t index) {
  const dipole_measured_medium *medium = (const dipole_measured_medium *)context + index;
  cli_put_text(rows, CLI_COLUMN("medium"), medium->name);
  cli_rows_json(rows->json, "channels", CLI_COLOURS, put_channel, medium);
}

static int run(void *settings, dipole_client *client) {
  const cli_common *common = settings;
  dipole_measured_medium *media;
  dipole_error error;
  size_t count;
  if (!dipole_media(client, &media, &count, &error)) {
    return cli_fail_error(&error);
  }
  if (common->form == CLI_TABLE) {
    cli_rows_print(stdout, 2, count * CLI_COLOURS, put_channel, media);
  } else if (common->form == CLI_CSV) {
    cli_rows_csv(stdout, true, count * CLI_COLOURS, put_channel, media);
  } else {
    cli_json json = {.file = stdout};
    cli_json_begin(&json, NULL, '{');
    cli_json_texts(&json, "units", "sigma_a", "1/mm", "sigma_s", "1/mm", NULL);
    cli_rows_json(&json, "media", count, put_medium, media);
    cli_json_end(&json, '}');
  }
  free(media);
  return CLI_OK;
}

const cli_command cli_command_media = {
    .name = "media",
    .about = "List the measured media and their coefficients",
    .more = "\n"
            "Only sigma_s (1 - g) was measured. It is listed as sigma_s, with g = 0.\n",
    .formats = "table,csv,json",
    .settings_bytes = sizeof(cli_common),
    .run = run,
    .examples = "  dipole media\n"
                "  dipole media --format csv\n",
};
