/* Lets user-mode Linux run on processors whose register file is larger than it knows.

   UML (6.1, as Debian has it) keeps a process's extended registers in a buffer that was sized before
   AMX, some 2.7 KiB of 11. Reading into it cuts the rest off; writing so short a set back is refused
   (EFAULT), and its first process dies: "ptrace set fp regs failed, errno = 14". Here a short set is
   laid over what the process has, and all of it is written.

       cc -shared -fPIC -o uml_registers.so uml_registers.c -ldl
       LD_PRELOAD=./uml_registers.so linux.uml ...
*/

#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

enum { LARGEST = 1 << 15 };

typedef long (*Ptrace)(int, int, void *, void *);

long ptrace(enum __ptrace_request request, ...)
{
    static Ptrace real;
    static char all[LARGEST];
    if (!real)
        real = (Ptrace)dlsym(RTLD_NEXT, "ptrace");
    va_list given;
    va_start(given, request);
    int pid = va_arg(given, int);
    void *address = va_arg(given, void *);
    void *data = va_arg(given, void *);
    va_end(given);
    if (request == PTRACE_SETREGSET && (long)address == NT_X86_XSTATE) {
        struct iovec *some = data, whole = {all, LARGEST};
        if (real(PTRACE_GETREGSET, pid, address, &whole) == 0 && some->iov_len < whole.iov_len) {
            memcpy(all, some->iov_base, some->iov_len);
            return real(PTRACE_SETREGSET, pid, address, &whole);
        }
    }
    return real(request, pid, address, data);
}
