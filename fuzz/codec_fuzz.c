/* libFuzzer target: wire bytes, records and damaged plans; the plans come from $ROSPLC_FUZZ_PLANS. */
#include "plan_checks.h"

static plan_case *cases;
static uint32_t count;

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
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const plan_case *one;
    uint32_t mode;
    if (size < 3)
        return 0;
    one = &cases[(data[0] | (uint32_t)data[1] << 8) % count];
    mode = data[2] % 8;
    data += 3;
    size -= 3;
    if (mode < 5) {
        check_wire(&one->plan, data, size, (int)(mode & 1));
    } else if (mode < 7) {
        uint8_t *record = calloc(one->plan.record_size, 1);
        if (size)
            memcpy(record, data, size < one->plan.record_size ? size : one->plan.record_size);
        check_record(&one->plan, record);
        free(record);
    } else {
        /* The input is the difference to a sound plan; alone it would hardly ever pass the head. */
        uint8_t *copy = exact(one->source.size);
        for (uint32_t i = 0; i < one->source.size; i++)
            copy[i] = one->source.data[i] ^ (i < size ? data[i] : 0);
        check_blob(copy, one->source.size, data, size);
        release(copy, one->source.size);
    }
    return 0;
}
