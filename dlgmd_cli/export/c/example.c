/* Reads grey frames from standard input, one byte per cell, and prints one line of CSV per frame:
   ffmpeg -i flight.mp4 -vf scale=WIDTH:HEIGHT:flags=area -f rawvideo -pix_fmt gray - | ./dlgmd */
#include "dlgmd.h"

#include <stdio.h>

#if DLGMD_FIXED
#define MP_UNIT (1.0 / 4096)
#define UNIT (1.0 / 32768)
#define S_UNIT (1.0 / 4096)
#else
#define MP_UNIT 1.0
#define UNIT 1.0
#define S_UNIT 1.0
#endif

static dlgmd_state state;
static uint8_t frame[DLGMD_HEIGHT * DLGMD_WIDTH];

int main(void)
{
    unsigned long number = 0;
    size_t n_read;
    dlgmd_reset(&state);
    puts("frame,mp,mp_abs,spike,alarm,g_x,g_y,ttc_s");
    while ((n_read = fread(frame, 1, sizeof frame, stdin)) == sizeof frame) {
        dlgmd_answer answer = dlgmd_step(&state, frame);
        if (!answer.valid) {
            printf("%lu,,,0,0,,,\n", number++);
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
        putchar('\n');
    }
    if (n_read > 0 || number == 0) {
        fprintf(stderr, "The input does not end with a whole frame of %d x %d bytes.\n", DLGMD_WIDTH,
                DLGMD_HEIGHT);
        return 1;
    }
    return 0;
}
