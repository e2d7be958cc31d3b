"""What several tests share: small clips, files of known content, a browser, the data beside the checkout."""
