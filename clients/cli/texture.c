/* dipole texture: maps an image of colours to images of the media that have them. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/image.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"

static const cli_option options[] = {
    CLI_TITLE("Media"),
    CLI_LENGTH_OPTIONS,
    CLI_OPTION(ONE, g, NULL, "mean cosine of the scattering angle (default: 0)"),
    CLI_OPTION(ONE, eta, "1.3", "refractive index inside over outside"),
    CLI_TITLE("Colours"),
    CLI_COLOUR_OPTIONS,
    CLI_OPTION(SWITCH, linear, NULL,
               "treat the values of a PNG as linear (default: what the file says, by a "
               "colour profile or gAMA, else sRGB)"),
    CLI_OPTION(NAMES, coefficients, NULL,
               "what to write: sigma_a, sigma_s (1/mm), and scattered, the single-scattering "
               "albedo for random walks (default: sigma_a,sigma_s)"),
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT, "the model that the colours are right for"),
    CLI_MOMENTS_OPTION,
    CLI_DEADLINE_OPTION,
    {0},
};

/* ---- the command line ------------------------------------------------------------------------ */

/* Values of one request: 2 MiB and some ten milliseconds. */
enum { REQUEST_VALUES = 262144, WANTED_MAX = 8 };

typedef struct texture_run {
  const cli_settings *settings;
  dipole_client *client;
  cli_profile names;
  dipole_varying_query query;
  size_t wanted_count;
  const dipole_choice *wanted[WANTED_MAX];
  cli_image images[WANTED_MAX]; /* images of the wanted coefficients */
  float *lengths_mm;            /* [REQUEST_VALUES] */
  uint64_t missing;             /* number of values whose colour no medium has */
  uint64_t first_missing;       /* index of the first of them */
  unsigned missing_status;
  double colour_least, colour_most;
} texture_run;

static int check(cli_settings *settings) {
  const char *length;
  if (settings->operand == NULL || settings->second_operand == NULL) {
    return cli_fail_usage("name two files: the image that is read, and the image that is written");
  }
  const cli_numbers *lengths = cli_lengths_find(settings, &length);
  if (lengths == NULL) {
    return CLI_USAGE;
  }
  if (lengths->count != 1 && lengths->count != CLI_COLOURS) {
    return cli_fail_usage("--%s has %zu values: give one, or three for red, green and blue", length,
                          lengths->count);
  }
  return CLI_OK;
}

/* Finds the coefficients that are wanted. */
static bool take_wanted(texture_run *run, const dipole_info *info) {
  static char *usual[] = {"sigma_a", "sigma_s"};
  const cli_texts *names = &run->settings->coefficients;
  const size_t count = names->count > 0 ? names->count : 2;
  for (size_t i = 0; i < count && i < WANTED_MAX; i++) {
    const dipole_choice *found = cli_named(info, DIPOLE_COEFFICIENT, "coefficients",
                                           names->count > 0 ? names->items[i] : usual[i]);
    if (found == NULL) {
      return false;
    }
    if ((run->query.coefficients & found->id) == 0) {
      run->query.coefficients |= found->id;
      run->wanted[run->wanted_count++] = found;
    }
  }
  return true;
}

static int take_settings(texture_run *run) {
  const cli_settings *settings = run->settings;
  const char *length;
  cli_lengths_find(settings, &length);
  if (!cli_profile_take_names(settings, run->client, &run->names)) {
    return CLI_USAGE;
  }
  const dipole_info *info = run->names.info;
  const dipole_choice *light = cli_named(info, DIPOLE_LIGHT, "light", settings->light);
  const dipole_choice *given = cli_choice(info, DIPOLE_LENGTH, length);
  if (light == NULL || given == NULL || !take_wanted(run, info)) {
    return CLI_USAGE;
  }
  const bool shares = run->query.coefficients == DIPOLE_SCATTERED;
  if (!cli_ends_with(settings->second_operand, ".pfm") &&
      !(shares && cli_ends_with(settings->second_operand, ".png"))) {
    return cli_fail_usage("%s: the name of the image that is written ends with .pfm, or with .png "
                          "if --coefficients is scattered",
                          settings->second_operand);
  }
  run->query = (dipole_varying_query){.model = run->names.model->id,
                                      .evaluator = DIPOLE_F32,
                                      CLI_QUERY_OF(&run->names),
                                      .coefficients = run->query.coefficients,
                                      .light = light->id,
                                      .given = given->id,
                                      .specular = settings->specular,
                                      .g = cli_numbers_pick(&settings->g, 0, 0),
                                      .eta = settings->eta.items[0],
                                      CLI_DEADLINE_OF(settings)};
  return CLI_OK;
}

/* ---- requests ---------------------------------------------------------------------------------- */

/* Fills the lengths of `count` values from number `first` on. */
static void set_lengths(texture_run *run, uint64_t first, size_t count, size_t channels) {
  const char *name;
  const cli_numbers *lengths = cli_lengths_find(run->settings, &name);
  const double unit_mm = cli_unit_mm(run->settings);
  for (size_t i = 0; i < count; i++) {
    const size_t channel = lengths->count == 1 ? 0 : (size_t)((first + i) % channels);
    run->lengths_mm[i] = (float)(unit_mm * lengths->items[channel]);
  }
}

static void take_values(texture_run *run, uint64_t first, const dipole_varying_result *result) {
  for (size_t i = 0; i < run->wanted_count; i++) {
    memcpy(run->images[i].values + first, dipole_coefficients_f32(result, run->wanted[i]->id),
           (size_t)result->value_count * sizeof(float));
  }
  run->colour_least = result->colour_least;
  run->colour_most = result->colour_most;
  if (run->missing == 0 && result->computed_count < result->value_count) {
    uint64_t i = 0;
    while (result->statuses[i] == DIPOLE_VALUE_OK || result->statuses[i] == DIPOLE_VALUE_FAR) {
      i++;
    }
    run->first_missing = first + i;
    run->missing_status = result->statuses[i];
  }
  run->missing += result->value_count - result->computed_count;
}

static bool map(texture_run *run, const cli_image *in, dipole_error *error) {
  cli_progress progress;
  const uint64_t count = in->width * in->height * in->channels;
  bool good = true;
  cli_progress_start(&progress, "values");
  for (uint64_t first = 0; good && first < count; first += REQUEST_VALUES) {
    dipole_varying_result *result;
    const uint64_t left = count - first;
    const size_t n = left < REQUEST_VALUES ? (size_t)left : REQUEST_VALUES;
    set_lengths(run, first, n, in->channels);
    run->query.colours = in->values + first;
    run->query.lengths_mm = run->lengths_mm;
    run->query.value_count = n;
    good =
        CLI_RETRY(run->settings, error, dipole_varying(run->client, &run->query, &result, error));
    if (good) {
      take_values(run, first, result);
      dipole_varying_result_free(result);
      cli_progress_show(&progress, (double)(first + n) / (double)count, (double)(first + n));
    }
  }
  cli_progress_wipe(&progress);
  return good;
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Says how many values have no medium, and where the first one is. Returns an exit status. */
static int report_missing(const texture_run *run, const cli_image *in) {
  static const char *const grey[] = {"grey"};
  if (run->missing == 0) {
    return CLI_OK;
  }
  const dipole_choice *status =
      cli_choice_of_id(dipole_get_info(run->client), DIPOLE_VALUE, run->missing_status);
  const uint64_t pixel = run->first_missing / in->channels;
  const char *const *channels = in->channels == CLI_COLOURS ? cli_colours : grey;
  return cli_say(
      CLI_BAD_ROWS,
      "%s: %llu of %llu values are NaN in what was written: no medium has their colour, which "
      "is from %.6g to %.6g, or their length; the first is %s of column %llu, row %llu: %s: "
      "allowed: %s",
      run->settings->operand, (unsigned long long)run->missing,
      (unsigned long long)(in->width * in->height * in->channels), run->colour_least,
      run->colour_most, channels[run->first_missing % in->channels],
      (unsigned long long)(pixel % in->width), (unsigned long long)(pixel / in->width),
      status != NULL ? status->name : "unknown", status != NULL ? status->about : "others");
}

/* Writes OUT, with the name of each of several coefficients before the end, as skin.sigma_a.pfm. */
static int write_images(const texture_run *run) {
  const char *out = run->settings->second_operand, *ending = strrchr(out, '.');
  bool good = true;
  for (size_t i = 0; good && i < run->wanted_count; i++) {
    char *file = NULL;
    good = run->wanted_count == 1 ? cli_image_write(out, &run->images[i])
                                  : asprintf(&file, "%.*s.%s%s", (int)(ending - out), out,
                                             run->wanted[i]->name, ending) > 0 &&
                                        cli_image_write(file, &run->images[i]);
    free(file);
  }
  return good ? CLI_OK : CLI_FAILED;
}

static int map_image(texture_run *run, const cli_image *in) {
  dipole_error error;
  const uint64_t count = in->width * in->height * in->channels;
  for (size_t i = 0; i < run->wanted_count; i++) {
    run->images[i] = *in;
    run->images[i].values = cli_allocate(count, sizeof(float));
  }
  run->lengths_mm = cli_allocate(REQUEST_VALUES, sizeof *run->lengths_mm);
  int status = map(run, in, &error) ? write_images(run) : cli_fail_error(&error);
  if (status == CLI_OK) {
    status = report_missing(run, in);
  }
  return status;
}

static int run_texture(const cli_settings *settings, dipole_client *client) {
  texture_run work = {.settings = settings, .client = client};
  cli_image in;
  int status = take_settings(&work);
  if (status == CLI_OK) {
    status = cli_image_read(settings->operand, settings->linear, &in) ? CLI_OK : CLI_FAILED;
    if (status == CLI_OK) {
      status = map_image(&work, &in);
      free(in.values);
    }
  }
  return status;
}

const cli_command cli_command_texture = {
    .name = "texture",
    .operand = "IN",
    .second_operand = "OUT",
    .about = "Map an image of colours to images of the media that have them",
    .more =
        "IN is a PNG or a PFM (portable float map). Each of its values is a colour: the diffuse "
        "albedo, the share that leaves of the power that entered. OUT ends with .pfm or, "
        "with --coefficients scattered, with .png; with several coefficients their names stand "
        "before the ending, as in skin.sigma_a.pfm. "
        "The media have the colours under the model, to 1e-5 with transport; `dipole invert` "
        "states the errors of coefficients, which are large next to white. A colour that no medium "
        "has becomes NaN; then the exit status is 3. An EXR goes through `ffmpeg -i "
        "skin.exr skin.pfm` before, and what is written through `ffmpeg -i skin.sigma_a.pfm "
        "sigma_a.exr`. Both keep the numbers. FFmpeg 5.1 turns a PFM upside down when it writes "
        "and reads one: add `-vf vflip` if the image that went in was no EXR.",
    .formats = "none",
    .options = {options},
    .parameters = CLI_OF_INVERTED,
    .examples =
        "  dipole texture skin.png skin.pfm --mean-free-path 1,.5,.3\n"
        "  dipole texture skin.png albedo.png --mean-free-path 1 --coefficients scattered\n",
    .check = check,
    .run = run_texture,
};
