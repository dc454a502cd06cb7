/* Reads grey frames from standard input, one byte per cell, and prints one line of CSV per frame:
   ffmpeg -i flight.mp4 -vf scale=WIDTH:HEIGHT:flags=area -f rawvideo -pix_fmt gray - | ./dlgmd
   Arguments are the steps from frame to frame in ms, again and again: ./dlgmd 16 17 17 for 60 frames a
   second. Without any, they are 1 / DLGMD_FPS. */
#include "dlgmd.h"

#include <stdio.h>
#include <stdlib.h>

#if DLGMD_FIXED
#define MP_UNIT (1.0 / 4096)
#define UNIT (1.0 / 32768)
#define S_UNIT (1.0 / 4096)
#else
#define MP_UNIT 1.0
#define UNIT 1.0
#define S_UNIT 1.0
#endif

static const char *const reasons[] = {"", "black", "flat", "noise", "frozen"};
static dlgmd_state state;
static dlgmd_sight sight;
static uint8_t frame[DLGMD_HEIGHT * DLGMD_WIDTH];

int main(int n_arguments, char **arguments)
{
    unsigned long number = 0;
    size_t n_read;
    dlgmd_reset(&state);
    dlgmd_health_reset(&sight);
    puts("frame,mp,mp_abs,spike,alarm,g_x,g_y,ttc_s,blind");
    while ((n_read = fread(frame, 1, sizeof frame, stdin)) == sizeof frame) {
        unsigned long n_steps = (unsigned long)n_arguments - 1;
        uint32_t step_ms = n_steps ? (uint32_t)atoi(arguments[1 + number % n_steps]) : 0;
        dlgmd_answer answer = dlgmd_step(&state, frame, step_ms);
        const char *reason = reasons[dlgmd_health(&sight, frame, step_ms)];
        if (!answer.valid) {
            printf("%lu,,,0,0,,,,%s\n", number++, reason);
            continue;
        }
        printf("%lu,%.9g,%.9g,%d,%d,", number++, (double)answer.mp * MP_UNIT,
               (double)answer.mp_abs * UNIT, answer.spike, answer.alarm);
        if (answer.mp > 0) {
            printf("%.9g,%.9g", (double)answer.g_x * UNIT, (double)answer.g_y * UNIT);
        } else {
            putchar(',');
        }
        putchar(',');
        if (answer.ttc_s > 0) {
            printf("%.9g", (double)answer.ttc_s * S_UNIT);
        }
        printf(",%s\n", reason);
    }
    if (n_read > 0 || number == 0) {
        fprintf(stderr, "The input does not end with a whole frame of %d x %d bytes.\n", DLGMD_WIDTH,
                DLGMD_HEIGHT);
        return 1;
    }
    return 0;
}
