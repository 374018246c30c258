"""The messages, structures and lists of dipoled's protocol. `make docs` makes this file from proto/."""

MESSAGES = {"hello": 1, "eval": 2, "media": 3, "statistics": 4, "ping": 5, "mc": 6, "cancel": 7,
    "table": 8, "offers": 9, "sample": 10, "invert": 11, "fit": 12, "varying": 13, "points": 14,
    "gather": 15, "fit_layers": 16, "tissue": 17, "fit_tissue": 18}

KINDS = {1: "model", 2: "evaluator", 3: "moments", 4: "quantity", 5: "spacing", 6: "status",
    7: "parameter", 8: "note", 9: "draw", 10: "length", 11: "phase", 12: "scale", 13: "axis",
    14: "fit_status", 15: "light", 16: "value", 17: "coefficient", 18: "unknown", 19: "property",
    20: "haemoglobin", 21: "tissue"}

STATUSES = {0: "ok", 1: "bad-magic", 2: "bad-version", 3: "bad-type", 4: "bad-length",
    5: "bad-count", 6: "bad-value", 7: "too-large", 8: "truncated", 9: "timeout", 10: "busy",
    11: "shutting-down", 12: "deadline", 13: "bad-address", 14: "not-allowed",
    15: "unknown-points", 16: "cancelled"}

QUANTITIES = {"R": 1, "albedo": 2, "cdf": 4, "r": 8, "dR_dr": 16, "ln_R": 32, "pdf": 64,
    "2_pi_r_R": 128, "S": 256, "R_f": 512, "dlnR_dln_sigma_a": 1024, "dlnR_dln_sigma_s": 2048,
    "model_error": 4096, "model_errors": 8192, "T": 16384, "path": 32768, "dpf": 65536,
    "time": 131072, "phase": 262144, "modulation": 524288, "balance": 1048576, "phase_f": 2097152,
    "modulation_f": 4194304}

CHOICES = {"model": "model", "evaluator": "evaluator", "moments": "moments", "spacing": "spacing",
    "draw": "draw", "given": "length", "light": "light", "axis": "axis", "scale": "scale",
    "status": "fit_status", "unknown": "unknown", "tissue": "tissue",
    "haemoglobin": "haemoglobin", "property": "property", "saturation_status": "fit_status",
    "total_status": "fit_status"}

SUMS = {"wanted": "quantity", "notes": "note", "coefficients": "coefficient",
    "unknowns": "unknown"}

# quantities with a value for each radius and channel, in the order of a reply's arrays
ELEMENTWISE = (1, 4, 16, 32, 64, 128, 256, 512, 1024, 2048, 8192, 16384, 32768, 65536, 131072, 262144, 524288, 2097152, 4194304)

# name: kind and name of each field, and its default unless 0
STRUCTURES = """\
header: u32 magic, u16 version, u16 type, u64 request_id, u32 payload_bytes, u32 deadline_ms
hello_request: u16 version_min, u16 version_max, u32 zero
hello_reply: u16 version, u16 version_min, u16 version_max, u16 workers, u32 choice_count,
    u32 limit_count, text software[32], text instruction_set[16], text R_unit[48]
choice: u32 kind, u32 id, text name[32], text about[96]
value: text name[40], u64 value
eval_request: u16 model = 29, u16 evaluator = 1, u16 moments = 1, u16 spacing = 1,
    u32 wanted = 11, u32 medium_count, u64 radius_count, f64 radius_start, f64 radius_stop,
    u32 layer_count = 1, u32 parameter_count
medium: f64 sigma_a, f64 sigma_s, f64 g, f64 eta = 1.3, f64 thickness
parameter: u16 parameter, u16 zero, u32 zero_too, f64 value
part: u32 part, u32 part_count, u64 first, u64 count
eval_reply: u32 part, u32 part_count, u64 first, u64 count, u16 model, u16 evaluator, u16 moments,
    u16 notes, u32 wanted, u32 channel_count
quantity_error: f64 numerical_error, f64 numerical_error_per_mm, f64 model_error
balance: f64 reflected, f64 transmitted, f64 unscattered_above, f64 unscattered_below,
    f64 absorbed_1, f64 absorbed_2, f64 absorbed_3, f64 absorbed_4, f64 absorbed_5,
    f64 absorbed_6, f64 absorbed_7, f64 absorbed_8
list_reply: u32 count, u32 zero
measured_medium: text name[16], f64 sigma_a[3], f64 sigma_s[3], f64 g[3], f64 eta[3],
    f64 thickness[3]
mc_request: u16 spacing, u16 albedo_count, u32 ring_count, f64 radius_start, f64 radius_stop,
    u32 layer_count = 1, u32 zero, u64 seed, u64 photons, f64 error_total, f64 error_rings
mc_reply: u16 state, u16 side_count, u16 albedo_count, u16 worst_side, u32 ring_count,
    u16 worst_albedo, u16 zero, f64 worst_from, f64 worst_to, f64 error_total, f64 error_rings,
    u64 number, u64 photons, u64 photons_expected
mc_energy: f64 albedo, f64 reflected, f64 reflected_error, f64 transmitted, f64 transmitted_error,
    f64 absorbed, f64 absorbed_error, f64 unfinished, f64 unfinished_error, f64 roulette,
    f64 roulette_error, f64 unscattered[2], f64 under[2], f64 under_error[2], f64 over[2],
    f64 over_error[2], f64 in_layer[8], f64 in_layer_error[8], f64 imbalance
cancel_request: u64 job_id
cancel_reply: u32 found, u32 zero
table_request: u16 model = 29, u16 moments = 1, u16 parameter_count, u16 layer_count = 1
table_reply: u16 layout, u16 model, u16 moments, u16 parameter_count, u32 word_count,
    u32 checksum, u32 notes, u32 layer_count, f64 albedo, f64 numerical_error,
    f64 numerical_error_per_mm, f64 model_error, f64 pieces_from, f64 pieces_to, f64 radius_least,
    f64 radius_most, f64 reach, f64 reach_growth, f64 model_errors[11], f64 numerical_errors[13]
offers_reply: u32 count, u32 taken
offer: u16 model, u16 evaluator, u32 meets, f64 error, f64 numerical_error, f64 cost,
    f64 prepare_cost
sample_request: u16 model = 29, u16 evaluator = 1, u16 moments = 1, u16 draw = 4, u32 wanted = 8,
    u32 medium_count, u64 sample_count, u64 sample_first, u64 seed, u32 layer_count = 1,
    u32 parameter_count
invert_request: u16 model = 29, u16 moments = 1, u16 given = 1, u16 light = 1, u32 medium_count,
    u16 specular, u16 errors = 2, f64 g, f64 eta = 1.3
invert_reply: u32 part, u32 part_count, u64 first, u64 count, u16 model, u16 moments, u16 given,
    u16 errors, u64 missing_count, f64 albedo_least, f64 albedo_most
fit_request: u64 set_count, u16 residuals, u16 zero, u32 zero_too
fit_design: u16 model = 29, u16 moments = 1, u16 axis = 1, u16 scale = 1, u32 reading_count,
    u16 parameter_count, u16 zero, f64 g, f64 eta, f64 thickness
fit_reply: u32 part, u32 part_count, u64 first, u64 count, u64 fitted_count, u32 reading_count,
    u32 notes
fitted: u16 status, u16 bounds, u16 field, u16 zero, u32 index, u32 evaluations, f64 sigma_a,
    f64 sigma_s_prime, f64 factor, f64 chi_squared, f64 reduced_chi_squared, f64 condition,
    f64 variance_a, f64 covariance_a_s, f64 variance_s, f64 covariance_a_factor,
    f64 covariance_s_factor, f64 variance_factor, f64 second_sigma_a, f64 second_sigma_s_prime,
    f64 second_factor, f64 second_chi_squared, f64 model_error
varying_request: u16 model = 29, u16 evaluator = 2, u16 moments = 1, u16 coefficients,
    u16 given = 1, u16 light = 1, u16 specular, u16 numbers, u32 wanted, u32 parameter_count,
    u64 value_count, f64 g, f64 eta = 1.3
varying_reply: u32 part, u32 part_count, u64 first, u64 count, u16 model, u16 evaluator,
    u16 moments, u16 coefficients, u32 wanted, u32 notes, u64 computed_count, f64 numerical_error,
    f64 model_error, f64 colour_least, f64 colour_most, f64 specular
points_request: u64 set[2], u32 channel_count, u32 zero, u64 point_count, u64 point_first,
    u64 part_points
points_reply: u64 set[2], u32 known, u32 zero, u64 point_next
gather_request: u16 model = 29, u16 evaluator = 3, u16 moments = 1, u16 parameter_count,
    u32 medium_count, u16 layer_count = 1, u16 zero, u64 set[2], u64 query_count,
    f64 tolerance = 0.01
gather_reply: u32 part, u32 part_count, u64 first, u64 count, u16 model, u16 evaluator,
    u16 moments, u16 zero, u32 channel_count, u32 notes, f64 bound, u64 points_visited,
    u64 nodes_visited
fit_layers_request: u16 scale = 1, u16 unknowns, u32 layer_count = 1, u32 reading_count, u32 zero
fit_layers_reply: u16 status, u16 unknowns, u32 reading_count, u64 evaluations, f64 factor,
    f64 factor_error, f64 chi_squared, f64 reduced_chi_squared, f64 numerical_error
estimate: u16 unknown, u16 status, u32 zero, f64 value, f64 error
tissue_request: u16 tissue, u16 haemoglobin = 1, u32 property_count, u32 wavelength_count,
    u32 zero
tissue_reply: u16 haemoglobin, u16 zero, u32 wavelength_count
fit_tissue_request: u64 set_count, u16 model = 29, u16 axis = 1, u16 scale = 1, u16 residuals,
    u16 tissue, u16 haemoglobin = 1, u32 property_count, u32 sought_count, u32 wavelength_count,
    u32 place_count, u32 zero, f64 detector_na
sought: u16 property, u16 zero, u32 zero_too, f64 low, f64 high
fit_tissue_reply: u32 part, u32 part_count, u64 first, u64 count, u64 fitted_count,
    u32 reading_count, u16 sought_count, u16 haemoglobin, f64 g, f64 eta
fitted_tissue: u16 status, u16 field, u16 saturation_status, u16 total_status, u32 index,
    u32 evaluations, f64 saturation, f64 saturation_error, f64 total, f64 total_error, f64 factor,
    f64 factor_error, f64 chi_squared, f64 reduced_chi_squared, f64 condition,
    f64 numerical_error, f64 model_error
tissue_estimate: u16 property, u16 status, u32 zero, f64 value, f64 error, f64 numerical
error: u16 status, u16 zero, u32 retry_after_ms, u64 index, text field[32], text allowed[80]
"""

# The structures that a payload begins with, and its parts: element, name, number of arrays, and
# of elements in each; wanted&12 is how many of these bits `wanted` has; [] is all that is left.
PAYLOADS = """\
hello_request: hello_request
hello_reply: hello_reply; choice choice[choice_count]; value limit[limit_count]
eval_request: eval_request; medium medium[layer_count*medium_count];
    parameter parameter[parameter_count]; real r[radius_count] if spacing is 1
eval_reply: eval_reply; f64 albedo[channel_count]; balance balance[channel_count*wanted&1048576];
    quantity_error errors[channel_count*wanted&4294967295]; real r[count] if wanted&8 is 1;
    real values[channel_count*wanted&7335925][count]
sample_reply: eval_reply; f64 albedo[channel_count];
    balance balance[channel_count*wanted&1048576];
    quantity_error errors[channel_count*wanted&4294967295];
    real values[channel_count*wanted&7335933][count]
media_reply: list_reply; measured_medium media[count]
statistics_reply: list_reply; value value[count]
mc_request: mc_request; medium medium[layer_count]; f64 albedo[albedo_count];
    parameter parameter[]
mc_reply: mc_reply; f64 edges[ring_count+1] unless state is 0; mc_energy energy[albedo_count];
    u64 photons[side_count*ring_count]; f64 rings[albedo_count*side_count*ring_count*2]
cancel_request: cancel_request
cancel_reply: cancel_reply
table_request: table_request; medium medium[layer_count]; parameter parameter[parameter_count]
table_reply: table_reply; medium medium[layer_count]; parameter parameter[parameter_count];
    u32 words[word_count]
offers_reply: offers_reply; offer offers[count]
sample_request: sample_request; medium medium[layer_count*medium_count];
    parameter parameter[parameter_count]; real u[sample_count] if draw is 1
invert_request: invert_request; f64 albedo[medium_count]; f64 length[medium_count]
invert_reply: invert_reply; f64 sigma_a[count]; f64 sigma_s[count]; f64 albedo[count];
    f64 sigma_a_error[count] unless errors is 0; f64 sigma_s_error[count] unless errors is 0;
    f64 model_error[count] if errors is 2
fit_request: fit_request; fit_design; parameter parameter[parameter_count];
    medium reference if scale is 3; f64 at[reading_count]; f64 source[reading_count];
    f64 detector[reading_count]; f64 values[reading_count*set_count];
    f64 errors[reading_count*set_count]
fit_reply: fit_reply; fitted sets[count]; f64 residuals[count*reading_count]
fit_layers_request: fit_layers_request; medium medium[layer_count]; f64 at[reading_count];
    f64 values[reading_count]; f64 errors[reading_count]
fit_layers_reply: fit_layers_reply; estimate estimates[unknowns&65535];
    f64 residuals[reading_count]
tissue_request: tissue_request; parameter property[property_count];
    f64 wavelength[wavelength_count]
tissue_reply: tissue_reply; medium media[wavelength_count]
fit_tissue_request: fit_tissue_request; parameter property[property_count];
    sought sought[sought_count]; f64 at[place_count]; f64 source[place_count];
    f64 detector[place_count]; f64 mhz[place_count]; f64 quantity[place_count];
    f64 wavelength[wavelength_count]; f64 values[place_count*set_count*wavelength_count];
    f64 errors[place_count*set_count*wavelength_count]
fit_tissue_reply: fit_tissue_reply; fitted_tissue sets[count];
    tissue_estimate estimates[count*sought_count];
    f64 covariance[count*sought_count*sought_count]; f64 residuals[count*reading_count]
varying_request: varying_request; parameter parameter[parameter_count];
    real sigma_a[value_count] if given is 0; real colour[value_count] unless given is 0;
    real sigma_s[value_count] if given is 0; real length[value_count] unless given is 0;
    real r[value_count] if numbers is 1; real u[value_count] if numbers is 2
varying_reply: varying_reply; real coefficients[coefficients&65535][count];
    real values[wanted&4294963199][count]; u8 statuses[count]
points_request: points_request; f64 xyz[part_points*3]; f32 power[channel_count*part_points]
points_reply: points_reply
gather_request: gather_request; medium medium[layer_count*medium_count];
    parameter parameter[parameter_count]; f64 xyz[query_count*3]
gather_reply: gather_reply; quantity_error errors[channel_count]; f64 M[channel_count*count]
offers_request: eval_request; medium medium[layer_count*medium_count];
    parameter parameter[parameter_count]; real r[radius_count] if spacing is 1
"""
