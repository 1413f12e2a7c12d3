/* libFuzzer target: wire bytes, records and damaged plans; the plans come from $ROSPLC_FUZZ_PLANS.
 *
 * An input is the plan's number (2 bytes), a mode, and the bytes. The executor's code is the same for every
 * type, so coverage alone would never tell two types apart: the table below does. */
#include "plan_checks.h"

#include "counts.h"

enum { OUTCOMES = 16, MOST = 4096 };

static plan_case *cases;
static uint32_t count;
#ifdef __clang__ /* libFuzzer counts these as covered places */
__attribute__((section("__libfuzzer_extra_counters")))
#endif
static uint8_t reached[MOST * OUTCOMES];

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    const char *path = getenv("ROSPLC_FUZZ_PLANS");
    (void)argc;
    (void)argv;
    if (!path)
        stop("ROSPLC_FUZZ_PLANS is not set");
    cases = read_plans(path, &count);
    if (count > MOST)
        stop("there are more plans than counters");
    counts_open();
    return 0;
}

static void note_outcome(uint32_t which, uint32_t outcome)
{
    reached[which * OUTCOMES + outcome % OUTCOMES] = 1;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const plan_case *one;
    uint32_t mode, which;
    counts_add(size);
    if (size < 3)
        return 0;
    which = (data[0] | (uint32_t)data[1] << 8) % count;
    one = &cases[which];
    mode = data[2] % 8;
    data += 3;
    size -= 3;
    counts_kind(which);
    if (mode < 5) {
        note_outcome(which, check_wire(&one->plan, data, size, (int)(mode & 1)));
    } else if (mode < 7) {
        uint8_t *record = calloc(one->plan.record_size, 1);
        if (size)
            memcpy(record, data, size < one->plan.record_size ? size : one->plan.record_size);
        check_record(&one->plan, record);
        free(record);
        note_outcome(which, 14);
    } else {
        /* The input is the difference to a sound plan; alone it would hardly ever pass the head. */
        uint8_t *copy = exact(one->source.size);
        for (uint32_t i = 0; i < one->source.size; i++)
            copy[i] = one->source.data[i] ^ (i < size ? data[i] : 0);
        check_blob(copy, one->source.size, data, size);
        release(copy, one->source.size);
        note_outcome(which, 15);
    }
    return 0;
}
