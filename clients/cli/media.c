/* dipole media: the measured media that the daemon knows. */
#include <stdlib.h>

#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"
#include "clients/cli/rows.h"

/* Puts one channel of a medium, whose name people see once. */
static void put_channel(cli_rows *rows, const void *context, size_t index) {
  const dipole_measured_medium *media = context;
  const size_t channel = index % CLI_COLOURS;
  const bool again = rows->form == CLI_TABLE && channel > 0;
  cli_put_text(rows, again ? "" : media[index / CLI_COLOURS].name, "medium");
  cli_put_text(rows, cli_colours[channel], "channel");
  cli_put_medium(rows, &media[index / CLI_COLOURS].channel[channel]);
}

static int run(const cli_settings *settings, dipole_client *client) {
  dipole_measured_medium *media;
  dipole_error error;
  size_t count;
  if (!dipole_media(client, &media, &count, &error)) {
    return cli_fail_error(&error);
  }
  const cli_report report = {.rows = count * CLI_COLOURS, .put_row = put_channel, .left = 2};
  cli_write(&report, settings->form, media);
  free(media);
  return CLI_OK;
}

const cli_command cli_command_media = {
    .name = "media",
    .about = "List the measured media and their coefficients",
    .more = "Only sigma_s (1 - g) was measured. It is listed as sigma_s, with g = 0.",
    .formats = "table,csv,json",
    .run = run,
    .examples = "  dipole media\n"
                "  dipole media --format csv\n",
};
