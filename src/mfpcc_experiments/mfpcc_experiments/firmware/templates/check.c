/*
 * Feeds recorded samples to the controller and compares its commands with those of the simulation.
 *
 * In double precision every bit has to be the same$where.
 */
#include <math.h>
#include <stdio.h>

#include "mfpcc.h"
#include "vectors.h"

static bool same(const mfpcc_command *command, const expected_command *expected)
{
    return command->duty[0] == expected->duty[0] && command->duty[1] == expected->duty[1]
        && command->duty[2] == expected->duty[2] && command->vectors[0] == expected->vectors[0]
        && command->vectors[1] == expected->vectors[1] && command->enable == expected->enable;
}

int main(void)
{
    static mfpcc_controller drive;
    static mfpcc_command command;
    int equal = 0;
    double largest = 0.0;

    mfpcc_init(&drive);
$references
    for (int n = 0; n < SAMPLES; ++n) {
        mfpcc_step(&drive, &SAMPLE[n], &command, NULL);
        equal += same(&command, &EXPECTED[n]) ? 1 : 0;
        for (int leg = 0; leg < 3; ++leg) {
            largest = fmax(largest, fabs((double)(command.duty[leg] - EXPECTED[n].duty[leg])));
        }
    }
    printf("%d of %d commands equal, largest difference of a duty %.3g\n", equal, SAMPLES, largest);
    return $verdict ? 0 : 1;
}
