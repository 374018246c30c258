/* channels: the media that a command is about, one for each channel, from options that several
 * commands have. */
#ifndef DIPOLE_CLI_CHANNELS_H
#define DIPOLE_CLI_CHANNELS_H

#include "clients/cli/cli.h"

typedef struct cli_medium_settings {
  const char *medium; /* names, separated by commas */
  cli_texts channel;
  cli_numbers sigma_a, sigma_s, g, eta;
} cli_medium_settings;

/* The options for settings whose member `medium` is a cli_medium_settings. */
#define CLI_MEDIUM_OPTIONS(settings)                                                               \
  {"Medium", NULL, NULL, CLI_HEADING, 0},                                                          \
      {"medium", "NAME[,NAME...]",                                                                 \
       "measured media, see `dipole media`: red, green and blue of each", CLI_TEXT,                \
       offsetof(settings, medium.medium)},                                                         \
      {"channel", "COLOUR[,...]", "red, green or blue. Of each only these (default: all)",         \
       CLI_NAMES, offsetof(settings, medium.channel)},                                             \
      {"sigma-a", "X[,X...]", "absorption coefficient, 1/mm; one value for each channel",          \
       CLI_NUMBERS, offsetof(settings, medium.sigma_a)},                                           \
      {"sigma-s", "X[,X...]",                                                                      \
       "scattering coefficient, 1/mm; a single value holds for all channels", CLI_NUMBERS,         \
       offsetof(settings, medium.sigma_s)},                                                        \
      {"g", "X[,X...]", "mean cosine of the scattering angle (default: 0)", CLI_NUMBERS,           \
       offsetof(settings, medium.g)},                                                              \
  {                                                                                                \
    "eta", "X[,X...]",                                                                             \
        "refractive index inside over outside (default: the measured\nmedium's, else 1.3)",        \
        CLI_NUMBERS, offsetof(settings, medium.eta)                                                \
  }

typedef struct cli_channel {
  char name[36];
  dipole_medium medium;
} cli_channel;

typedef struct cli_channels {
  const char *medium; /* names of measured media, as given; NULL: none */
  size_t count;
  cli_channel *items;
} cli_channels;

/* What can be seen to be wrong without a daemon: an exit status. */
int cli_channels_check(const cli_command *command, const cli_medium_settings *settings);

/* Whether any of the options is given. */
bool cli_channels_given(const cli_medium_settings *settings);

/* Fills *channels, whose items are to be freed. Says what is wrong and returns an exit status. */
int cli_channels_take(const cli_command *command, const cli_medium_settings *settings,
                      dipole_client *client, cli_channels *channels);

#endif
