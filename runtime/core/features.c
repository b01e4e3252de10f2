/* Signals of a sample, and features of signals, filters and observer. As `features.FeatureMap`. */
#include <string.h>

#include "motorlens.h"

void motorlens_signals(const motorlens_features *map, const motorlens_sample *sample, double *signals)
{
    double measured[5];
    measured[0] = 1.0;
    measured[1] = sample->voltage_V;
    measured[2] = sample->current_A;
    measured[3] = sample->voltage_V - map->resistance_ohm * sample->current_A;
    measured[4] = sample->ambient_C;
    for (int k = 0; k < map->signals; k++)
        signals[k] = measured[map->first[k]] * measured[map->second[k]];
}

void motorlens_features_of(const motorlens_features *map, const double *columns, double *features)
{
    for (int k = 0; k < map->features; k++) {
        features[k] = columns[map->plus[k]];
        if (map->minus[k] != UINT16_MAX)
            features[k] -= columns[map->minus[k]];
    }
}

void motorlens_whitened(const motorlens_envelope *envelope, int count, motorlens_wide *features, motorlens_lanes *columns,
                        double *squares)
{
    const motorlens_real *column = envelope->whitening;
    for (int lane = 0; lane < MOTORLENS_LANES; lane++)
        squares[lane] = 0.0;
    for (int j = 0; j < count; j++)
        for (int lane = 0; lane < MOTORLENS_LANES; lane++)
            features[j][lane] -= envelope->mean[j];
    for (int k = 0; k < count; k++) {
        motorlens_wide sum = {0}; /* in double: these are small differences of large numbers */
        if (column == NULL) {
            memcpy(sum, features[k], sizeof sum);
        } else {
            for (int j = k; j < count; j++)
                for (int lane = 0; lane < MOTORLENS_LANES; lane++)
                    sum[lane] += (double)column[j - k] * features[j][lane];
            column += count - k;
        }
        for (int lane = 0; lane < MOTORLENS_LANES; lane++) {
            columns[k][lane] = (motorlens_real)(envelope->reads_z ? sum[lane] : features[k][lane]);
            squares[lane] += sum[lane] * sum[lane];
        }
    }
}
