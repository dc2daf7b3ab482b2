"""The functions of `labrig`, by what they load: `import labrig` finds each where it stands."""
