"""The frozen, validated models of configuration files; `labrig.config` reads YAML into them."""
