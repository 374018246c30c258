/* dipole tissue: the coefficients of tissues at wavelengths, or a list of tissues and spectra. Here are
 * the options of tissues, too, which other commands have. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "core/tissue/tissue.h"
#include "proto/decimal.h"

/* ---- wavelengths ----------------------------------------------------------------------------- */

/* Reads one wavelength, or FROM:TO:STEP, as three numbers. Returns false if it is neither. */
static bool read_range(const char *text, double range[3]) {
  char *rest = cli_copy(text, strlen(text)), *one;
  size_t count = 0;
  for (; (one = strsep(&rest, ":")) != NULL; count++) {
    if (count == 3 || !decimal_read(one, &range[count]) || !isfinite(range[count])) {
      return false;
    }
  }
  if (count == 1) {
    range[1] = range[0];
    range[2] = 1;
  }
  return count != 2 && range[2] > 0 && range[1] >= range[0];
}

/* Reads the wavelengths. If one is wrong, or they are too many, says so and returns NULL. */
static double *read_wavelengths(const cli_texts *texts, size_t *count) {
  double *all = cli_allocate(CORE_TISSUE_WAVELENGTHS_MAX, sizeof *all);
  *count = 0;
  for (size_t i = 0; i < texts->count; i++) {
    double range[3];
    if (!read_range(texts->items[i], range)) {
      cli_fail_usage(
          "--wavelengths: '%s' is no wavelength in nm, and no FROM:TO:STEP as 450:1000:5",
          texts->items[i]);
      return NULL;
    }
    /* a last one that rounding has put behind the end counts */
    const double steps = floor((range[1] - range[0]) / range[2] + 1e-9);
    if (steps >= (double)(CORE_TISSUE_WAVELENGTHS_MAX - *count)) {
      cli_fail_usage("--wavelengths: give at most %d", CORE_TISSUE_WAVELENGTHS_MAX);
      return NULL;
    }
    for (double k = 0; k <= steps; k++) {
      all[(*count)++] = range[0] + k * range[2];
    }
  }
  return all;
}

/* ---- tissues --------------------------------------------------------------------------------- */

int cli_tissue_check(const cli_settings *settings) {
  if (settings->tissue.count == 0) {
    const char *haemoglobin = settings->haemoglobin; /* NULL: the command takes no tissues */
    return settings->wavelengths.count == 0 && settings->scatter.count == 0 &&
                   (haemoglobin == NULL || strcmp(haemoglobin, "prahl") == 0)
               ? CLI_OK
               : cli_fail_usage("--wavelengths, --scatter and --haemoglobin are those of a tissue: "
                                "give --tissue, too");
  }
  if (cli_medium_given(settings)) {
    return cli_fail_usage("--tissue gives the medium whole: leave --medium, --channel, --sigma-a, "
                          "--sigma-s, --g, --eta, --thickness and --layer out; g=X, eta=X and "
                          "thickness=MM are properties");
  }
  if (settings->tissue.count > CORE_LAYERS_MAX) {
    return cli_fail_usage("--tissue: %zu layers: give at most %d", settings->tissue.count,
                          CORE_LAYERS_MAX);
  }
  if (settings->wavelengths.count == 0) {
    return cli_fail_usage("--tissue needs --wavelengths, as 650,850 or 450:1000:5");
  }
  if (settings->scatter.count == 1 || settings->scatter.count > 3) {
    return cli_fail_usage("--scatter: give A,B or A,B,SHARE, as 4.6,1.42");
  }
  size_t count;
  return read_wavelengths(&settings->wavelengths, &count) != NULL ? CLI_OK : CLI_USAGE;
}

const dipole_choice *cli_property(const dipole_info *info, const char *option, const char *name) {
  const dipole_choice *one, *near = NULL, *found = cli_choice(info, DIPOLE_PROPERTY, name);
  const size_t length = strlen(name);
  size_t count = 0;
  for (size_t from = 0;
       found == NULL && (one = cli_next_choice(info, DIPOLE_PROPERTY, &from)) != NULL;) {
    if (strncmp(one->name, name, length) == 0 && one->name[length] == '_') {
      near = one;
      count++;
    }
  }
  found = count == 1 ? near : found;
  if (found == NULL) {
    char known[1024];
    cli_list_names(info, DIPOLE_PROPERTY, known, sizeof known);
    cli_fail_usage("%s: '%s' is no property; they are %s", option, name, known);
  }
  return found;
}

bool cli_tissue_read(const dipole_info *info, const char *text, dipole_tissue_query *query,
                     dipole_parameter properties[CORE_PROPERTIES_END]) {
  query->properties = properties;
  char *rest = cli_copy(text, strlen(text)), *one;
  for (bool first = true; (one = strsep(&rest, ",")) != NULL; first = false) {
    char *number = strchr(one, '=');
    if (number == NULL && first) {
      const dipole_choice *named = cli_named(info, DIPOLE_TISSUE, "tissue", one);
      if (named == NULL) {
        return false;
      }
      query->tissue = named->id;
      continue;
    }
    if (number != NULL) {
      *number++ = '\0';
    }
    char option[96];
    snprintf(option, sizeof option, "--tissue %.80s", text);
    const dipole_choice *property = cli_property(info, option, one);
    if (property == NULL) {
      return false;
    }
    double value;
    if (number == NULL || !decimal_read(number, &value)) {
      return cli_fails_usage("--tissue %s: give %s=X, a number", text, one);
    }
    if (query->property_count == CORE_PROPERTIES_END) {
      return cli_fails_usage("--tissue %s: too many properties", text);
    }
    properties[query->property_count++] = (dipole_parameter){property->id, value};
  }
  return true;
}

/* Requests one layer at all wavelengths. */
static int take_layer(const cli_settings *settings, dipole_client *client, cli_profile *profile,
                      uint32_t layer) {
  const size_t count = profile->channel_count;
  const char *text = settings->tissue.items[layer];
  dipole_parameter properties[CORE_PROPERTIES_END + 3];
  dipole_medium *media = cli_allocate(count, sizeof *media);
  dipole_error error;
  dipole_tissue_query query = {.haemoglobin = profile->haemoglobin->id,
                               .wavelengths_nm = profile->wavelengths_nm,
                               .wavelength_count = (uint32_t)count,
                               CLI_DEADLINE_OF(settings)};
  if (!cli_tissue_read(profile->info, text, &query, properties)) {
    return CLI_USAGE;
  }
  for (size_t i = 0; i < settings->scatter.count; i++) {
    properties[query.property_count++] = (dipole_parameter){
        (const uint16_t[]){CORE_PROPERTY_A, CORE_PROPERTY_B, CORE_PROPERTY_RAYLEIGH}[i],
        settings->scatter.items[i]};
  }
  if (!CLI_RETRY(settings, &error, dipole_tissue(client, &query, media, &error))) {
    char what[96];
    snprintf(what, sizeof what, "--tissue %.80s: ", text);
    return cli_fail_error_of(what, &error);
  }
  if (layer + 1 < profile->layer_count && media[0].thickness_mm == 0) {
    return cli_fail_usage("--tissue %s: only the last layer may be a half space: add thickness=MM",
                          text);
  }
  for (size_t i = 0; i < count; i++) {
    profile->media[i * profile->layer_count + layer] = media[i];
  }
  return CLI_OK;
}

int cli_tissue_take(const cli_settings *settings, dipole_client *client, cli_profile *profile) {
  size_t count, bytes = 1;
  int status = CLI_OK;
  profile->haemoglobin =
      cli_named(profile->info, DIPOLE_HAEMOGLOBIN, "haemoglobin", settings->haemoglobin);
  profile->wavelengths_nm = read_wavelengths(&settings->wavelengths, &count);
  if (profile->haemoglobin == NULL || profile->wavelengths_nm == NULL) {
    return CLI_USAGE;
  }
  cli_profile_set_channels(profile, count, (uint32_t)settings->tissue.count);
  for (size_t i = 0; i < count; i++) {
    snprintf(profile->names[i], CLI_CHANNEL_BYTES, "%.9g nm", profile->wavelengths_nm[i]);
  }
  char *whole = NULL;
  for (uint32_t i = 0; status == CLI_OK && i < profile->layer_count; i++) {
    const char *text = settings->tissue.items[i];
    whole = cli_resize(whole, bytes + strlen(text) + 1, 1);
    bytes += (size_t)sprintf(whole + bytes - 1, "%s%s", i > 0 ? " " : "", text);
    status = take_layer(settings, client, profile, i);
  }
  profile->tissue = whole;
  return status;
}

/* ---- the command ----------------------------------------------------------------------------- */

static void put_facts(cli_rows *rows, const void *context) {
  cli_put_profile(rows, context);
}

static void put_coefficients(cli_rows *rows, const void *context, size_t index) {
  const cli_profile *profile = context;
  const dipole_medium *layers = cli_profile_layers(profile, index);
  cli_put_number(rows, profile->wavelengths_nm[index], "wavelength_nm", "wavelength", "nm");
  cli_put_medium(rows, layers, profile->layer_count);
  if (profile->layer_count == 1) {
    cli_put_number(rows, layers->sigma_s_per_mm * (1 - layers->g), "sigma_s_prime", "sigma_s'",
                   "1/mm");
  }
}

/* The spectra: their properties, ranges and sources. */
static const struct {
  unsigned property;
  const char *about;
} spectra[] = {
#define ANY ""
#define PRAHL " (prahl)"
#define UCL " (ucl)"
#define CORE_SPECTRUM(PROPERTY, HAEMOGLOBIN, from_nm, to_nm, factor, source, ...)                  \
  {CORE_PROPERTY_##PROPERTY, #from_nm " to " #to_nm " nm: " source HAEMOGLOBIN},
#define CORE_FORMULA(PROPERTY, from_nm, to_nm, per_mm, source)                                     \
  {CORE_PROPERTY_##PROPERTY, #from_nm " to " #to_nm " nm: " source},
#include "core/tissue/spectra.def"
};

/* The list of tissues, properties and spectra. */
typedef struct listing {
  size_t count;
  struct {
    const char *kind, *name, *about;
  } items[256];
} listing;

static void add_item(listing *all, const char *kind, const char *name, const char *about) {
  if (all->count < sizeof all->items / sizeof all->items[0]) {
    all->items[all->count].kind = kind;
    all->items[all->count].name = name;
    all->items[all->count++].about = about;
  }
}

static void put_item(cli_rows *rows, const void *context, size_t index) {
  const listing *all = context;
  cli_put_text(rows, all->items[index].kind, "kind");
  cli_put_text(rows, all->items[index].name, "name");
  cli_put_text(rows, all->items[index].about, "about");
}

static int write_list(const cli_settings *settings, const dipole_info *info) {
  static const struct {
    enum dipole_kind kind;
    const char *name;
  } kinds[] = {{DIPOLE_TISSUE, "tissue"}, {DIPOLE_PROPERTY, "property"}};
  listing all = {0};
  for (size_t i = 0; i < sizeof kinds / sizeof kinds[0]; i++) {
    const dipole_choice *one;
    for (size_t from = 0; (one = cli_next_choice(info, kinds[i].kind, &from)) != NULL;) {
      add_item(&all, kinds[i].name, one->name, one->about);
    }
  }
  for (size_t i = 0; i < sizeof spectra / sizeof spectra[0]; i++) {
    add_item(&all, "spectrum", core_choice_by_id(core_properties, spectra[i].property)->name,
             spectra[i].about);
  }
  const cli_report report = {.rows = all.count, .put_row = put_item, .left = 3};
  cli_write(&report, settings->form, &all);
  return CLI_OK;
}

static int check(cli_settings *settings) {
  return cli_tissue_check(settings);
}

static int run_tissue(const cli_settings *settings, dipole_client *client) {
  cli_profile profile = {.info = dipole_get_info(client)};
  if (settings->tissue.count == 0) {
    return write_list(settings, profile.info);
  }
  const int status = cli_tissue_take(settings, client, &profile);
  if (status == CLI_OK) {
    const cli_report report = {
        .facts = put_facts, .rows = profile.channel_count, .put_row = put_coefficients};
    cli_write(&report, settings->form, &profile);
  }
  return status;
}

static const cli_option options[] = {
    CLI_TITLE("Tissue"), CLI_TISSUE_OPTIONS, CLI_DEADLINE_OPTION, {0}};

const cli_command cli_command_tissue = {
    .name = "tissue",
    .about = "Show the coefficients of a tissue at wavelengths, or list tissues",
    .more = "Without --tissue it lists tissues by name, their properties, and the spectra with "
            "their ranges in nm. A property is named with or without its unit: hbo2 is hbo2_uM.",
    .formats = "table,csv,json",
    .options = {options},
    .check = check,
    .run = run_tissue,
    .examples =
        "  dipole tissue\n"
        "  dipole tissue --tissue liver --wavelengths 650,850\n"
        "  dipole tissue --tissue hbo2=56,hb=24,water=.65,a=4.6,b=1.42 --wavelengths 450:1000:5 "
        "--format csv\n"
        "  dipole tissue --tissue epidermis,thickness=.06 --tissue dermis --wavelengths "
        "450:700:10\n",
};
