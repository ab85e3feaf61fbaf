// Between the readers of animation and the importer, which is a module of its own: assimp takes milliseconds to load,
// so that is left to scenes that have an animation. The program finds the module in its own folder or in
// ../lib/strandbake.
#pragma once

#include <string>

#include "formats/animation.h"
#include "formats/animation_guard.h"

// Fills `animation`, which is empty before, from a file that the guard let through. `source` names the file in
// messages. Throws InputError.
extern "C" using StrandbakeImportAnimation =
    void(const strandbake::GuardedFile& file, const std::string& source, const strandbake::AnimationOptions& options,
         strandbake::Warnings& warnings, strandbake::Animation& animation);
// What the module exports.
extern "C" StrandbakeImportAnimation strandbake_import_animation;
