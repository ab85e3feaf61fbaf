// strandbake VERB: reads the command line, runs one verb, and is the only place that ends the process.
#include <malloc.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <map>
#include <new>
#include <system_error>

#include "cli/console.h"
#include "cli/verbs.h"
#include "cli/version.h"
#include "formats/error.h"
#include "gpu/opencl.h"

// Threads that have nothing to do sleep, unless whoever runs us wants it otherwise: where cores are shared, a thread
// that spins keeps the one that it waits for from running. The runtimes of OpenMP look at the environment once, before
// main().
__attribute__((constructor(101))) static void let_threads_sleep() {
  ::setenv("OMP_WAIT_POLICY", "passive", 0);
}

int main(int argc, char** argv) {
  using namespace strandbake;
  CLI::App app{"Strandbake simulates hair offline: a scene in, a cache with every vertex of every frame out.",
               "strandbake"};
  app.set_version_flag("--version", "strandbake " STRANDBAKE_VERSION);
  app.require_subcommand(1);
  app.footer(
      "Exit codes: 0 good, 1 differs or invalid, 2 usage, 3 input, 4 device, 5 disk, 6 not finite, 130 interrupted.");

  std::map<const CLI::App*, Verb> verbs;
  const auto add = [&](const char* name, const char* help, Verb (*declare)(CLI::App&)) {
    CLI::App* const verb = app.add_subcommand(name, help);
    verbs[verb] = declare(*verb);
  };
  add("bake", "Simulate a scene and write its cache", add_bake);
  add("check", "List every fault of a scene, or what would be run", add_check);
  add("info", "Say what a cache holds", add_info);
  add("compare", "Say how far a cache is from a golden one", add_compare);
  add("digest", "Write what a later bake can be compared with, small enough for git", add_digest);
  add("preview", "Draw a contact sheet or a clip of a cache", add_preview);
  add("view", "Write a page that plays a cache in a browser", add_view);
  add("groom", "Make hair, or convert a groom to .hair", add_groom);
  add("devices", "List the OpenCL devices that can bake", add_devices);
  add("docs", "Print the reference of the scene file, the manual page, schemas or completions", add_docs);
  add("bench", "Measure the speed of this machine and program", add_bench);

  // Large blocks go back to the system when they are freed. By default glibc keeps what is as large as the largest that
  // was freed so far: here whole grooms.
  ::mallopt(M_MMAP_THRESHOLD, 1 << 20);
  // A write beyond the limit of a file's size is an error like that of a full disk, and no reason to die.
  std::signal(SIGXFSZ, SIG_IGN);
  try {
    app.parse(argc, argv);
    const int code = verbs.at(app.get_subcommands().front())();
    if (std::fflush(stdout) != 0) throw std::system_error(errno, std::generic_category(), "standard output");
    return code;
  } catch (const CLI::ParseError& error) {
    // Asking for help is no mistake; anything else is one of usage.
    return app.exit(error) == 0 ? kGood : kUsage;
  } catch (const InputError& error) {
    print_error(error.what());
    return kInput;
  } catch (const DeviceError& error) {
    print_error(error.what());
    return kDevice;
  } catch (const DiskError& error) {
    print_error(error.what());
    return kDisk;
  } catch (const std::system_error& error) {  // the readers have their own; what is left is output
    print_error(error.what());
    return kDisk;
  } catch (const std::bad_alloc&) {
    print_error("not enough memory for this scene; `strandbake check` tells what it needs");
    return kInput;
  } catch (const std::exception& error) {
    print_error(error.what());
    return kInput;
  }
}
