/* Runs a libFuzzer target over files, without libFuzzer: any compiler will do. usage: program FILE... */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int main(int argc, char **argv)
{
    LLVMFuzzerInitialize(&argc, &argv);
    for (int i = 1; i < argc; i++) {
        FILE *file = fopen(argv[i], "rb");
        uint8_t *data = malloc(1 << 20);
        size_t size;
        if (!file || !data)
            return 2;
        fprintf(stderr, "%s\n", argv[i]); /* the last one is the culprit, if there is one */
        size = fread(data, 1, 1 << 20, file);
        fclose(file);
        data = realloc(data, size ? size : 1); /* so that the sanitizer sees one byte too many */
        LLVMFuzzerTestOneInput(data, size);
        free(data);
    }
    return 0;
}
