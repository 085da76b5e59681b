/*
$about
*/

#ifndef ${NAME}_H
#define ${NAME}_H

#ifdef __cplusplus
extern "C" {
#endif

#define ${NAME}_SAMPLING_TIME $dt /* s */

$structures
/* The state at rest. */
void ${name}_start(struct ${name}_state *state);

/* What the sensors show now. */
void ${name}_outputs(const struct ${name}_state *state, const struct ${name}_input *input, struct ${name}_output *output);

/* The state $interval s later, the input held. */
void ${name}_step(struct ${name}_state *state, const struct ${name}_input *input);

#ifdef __cplusplus
}
#endif

#endif
